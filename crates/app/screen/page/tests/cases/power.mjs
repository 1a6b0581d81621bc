// From emergency stop to ready, homing, reset, and what state is shown.
import assert from 'node:assert/strict';
import { at, number, powerTo, ready, takeControl, text, until, view } from '../operator.mjs';
import { anywhere, onMadeUp } from '../case.mjs';

anywhere('advice goes from emergency stop to ready', async (page) => {
  // Who only watches may stop, too.
  await page.locator(at('estop')).click();
  await until('E-STOP', async () => (await text(page, 'state')) === 'E-STOP' || text(page, 'state'));
  assert.match(await text(page, 'advice'), /Reset E-stop/);
  assert.equal(await page.locator(at('power')).isDisabled(), true, 'who only watches cannot switch on');
  await takeControl(page);
  await page.locator(at('power')).click();
  await until('off', async () => (await text(page, 'state')) === 'Off' || text(page, 'state'));
  assert.match(await text(page, 'advice'), /power on/);
  await page.locator(at('power')).click();
  await until('on', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
  await ready(page);
  await page.locator(at('estop')).click();
  await until('stopped', async () => (await text(page, 'state')) === 'E-STOP' || text(page, 'state'));
});

onMadeUp('one press of the power button is one step, however it is pressed', async (page) => {
  await takeControl(page);
  const sent = () => page.evaluate(() => globalThis.madeUpCommands.filter((name) => ['estop_reset', 'on', 'off'].includes(name)));
  const power = page.locator(at('power'));
  await page.locator(`${at('power')}:enabled`).waitFor();
  await power.dblclick();
  await until('one command', async () => (await sent()).length === 1 || sent());
  await page.waitForTimeout(200);
  assert.deepEqual(await sent(), ['estop_reset'], 'a double click');
  await page.locator(`${at('power')}:enabled`).waitFor();
  // A key that is held repeats after a while.
  await power.focus();
  await page.keyboard.down('Enter');
  for (let i = 0; i < 15; i += 1) {
    await page.waitForTimeout(100);
    await page.keyboard.down('Enter');
  }
  await page.keyboard.up('Enter');
  assert.deepEqual(await sent(), ['estop_reset', 'on'], 'a key that is held');
  assert.equal(await power.evaluate((button) => button === document.activeElement), true, 'the keyboard is still there');
  // Somebody else has pressed STOP: the finger that comes down to switch off resets nothing.
  await page.evaluate(() => globalThis.changeMadeUp({ machineState: 'estop' }));
  await until('E-STOP', async () => (await text(page, 'state')) === 'E-STOP' || text(page, 'state'));
  const box = await power.boundingBox();
  await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
  assert.deepEqual(await sent(), ['estop_reset', 'on'], 'another meaning');
  // A step is one step.
  await ready(page);
  await page.locator(`${at('step')}:enabled`).dblclick();
  await page.waitForTimeout(300);
  assert.equal(await page.evaluate(() => globalThis.madeUpCommands.filter((name) => name === 'step').length), 1);
});

onMadeUp('figures that are not live say so', async (page) => {
  await ready(page);
  const quiet = (on) => page.evaluate((on) => globalThis.quietMadeUp(on), on);
  const told = page.locator(at('no-data'));
  const dimmed = () => page.locator('.positions .axes').evaluate((element) => Number(getComputedStyle(element).opacity) < 0.5);
  const places = () => page.evaluate(() => JSON.stringify([...document.querySelectorAll('main button, main .number')].map((element) => [element.getBoundingClientRect().x, element.getBoundingClientRect().y])));
  assert.deepEqual([await told.count(), await dimmed()], [0, false]);
  const before = await places();
  const from = Date.now();
  await quiet(true);
  await told.waitFor({ timeout: 1500 });
  assert.ok(Date.now() - from > 250, 'not before 300 ms');
  assert.equal(await dimmed(), true);
  assert.equal(await places(), before, 'nothing jumps');
  await until('seconds', async () => /no data for [23] s/.test(await told.innerText()) || told.innerText());
  await quiet(false);
  await told.waitFor({ state: 'detached' });
  assert.equal(await dimmed(), false);
});

onMadeUp('every state of the machine is written whole, and the whole of a rejection can be read', async (page) => {
  await ready(page);
  const states = ['running', 'holding', 'held', 'stopping', 'stopped', 'dwell', 'program_stop', 'fault', 'done'];
  for (const language of ['en', 'de']) {
    await page.locator(at('menu')).click();
    await page.locator(`dialog[open] [lang="${language}"]`).click();
    await page.keyboard.press('Escape');
    for (const activity of ['program', 'homing', 'mdi', 'jog']) {
      for (const state of activity === 'program' ? states : ['running']) {
        await page.evaluate((changes) => globalThis.changeMadeUp({ ...changes, hold: true }), { activity, state });
        await page.waitForTimeout(80);
        const [label, needed, given] = await page.locator(at('state')).evaluate((element) => [element.innerText, element.scrollWidth, element.clientWidth]);
        assert.ok(needed <= given, `${language}: ${label} needs ${needed} px of ${given}`);
      }
    }
    await page.evaluate(() => globalThis.changeMadeUp({ activity: 'none', state: 'idle', hold: false }));
  }
  await page.locator(at('menu')).click();
  await page.locator('dialog[open] [lang="en"]').click();
  await page.keyboard.press('Escape');
  const reason = `${'this is why the control rejects the command, '.repeat(8)}and this is its end`;
  await page.evaluate((reason) => globalThis.rejectMadeUp(reason), reason);
  const places = () => page.evaluate(() => [...document.querySelectorAll('header button:not(.away), [role="tab"]')].map((element) => Math.round(element.getBoundingClientRect().top)));
  const before = await places();
  await page.locator('#feed_override').fill('50');
  const rejection = page.locator(at('rejection'));
  await rejection.waitFor();
  assert.deepEqual(await places(), before, 'nothing moves');
  const isCovered = () => page.evaluate(() => [...document.querySelectorAll('[role="tab"]')].some((tab) => {
    const box = tab.getBoundingClientRect();
    return !tab.contains(document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2));
  }));
  assert.equal(await isCovered(), false, 'a long sentence covers no tab');
  await page.locator(at('said-whole')).click();
  assert.deepEqual(await places(), before, 'nothing moves when the whole is shown');
  const isWhole = await rejection.evaluate((element) => {
    // Its last word, and whether it is what is seen there.
    const range = document.createRange();
    const end = [...element.childNodes].filter((node) => node.nodeType === Node.TEXT_NODE && node.data.includes('its end')).at(-1);
    range.setStart(end, end.data.indexOf('its end'));
    range.setEnd(end, end.data.indexOf('its end') + 7);
    const box = range.getBoundingClientRect();
    return box.width > 0 && box.bottom <= innerHeight && element.contains(document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2));
  });
  assert.equal(isWhole, true, 'its end is seen');
  // In German what the number means comes first; the sentence of the server has the details.
  const language = async (name) => {
    await page.locator(at('menu')).click();
    await page.locator(`dialog[open] [lang="${name}"]`).click();
    await page.keyboard.press('Escape');
  };
  await language('de');
  assert.match(await rejection.innerText(), /^Abgelehnt \(901\): Diesen Befehl gibt es nicht.*\(im Original: this is why .* its end\)/s);
  await page.evaluate(() => globalThis.raiseMadeUpAlarm(413));
  await until('its alarm', async () => /^413: die Brücke .* \(im Original: made up\)/s.test(await text(page, 'advice')) || text(page, 'advice'));
  await page.evaluate(() => globalThis.changeMadeUp({ alarms: [], alarmText: '' }));
  await language('en');
  await page.evaluate(() => globalThis.rejectMadeUp(''));
  await page.locator(at('feed_override')).click();
  await rejection.waitFor({ state: 'detached' });
  // A message of the program does not move its list.
  await view(page, 'program');
  await page.evaluate(() => globalThis.changeMadeUp({ activity: 'program', state: 'program_stop', hold: true, message: '' }));
  await page.waitForTimeout(100);
  const list = () => page.locator(at('program-list')).boundingBox();
  const at_first = await list();
  await page.evaluate(() => globalThis.changeMadeUp({ message: 'Measure the bore. '.repeat(20) }));
  await page.locator(at('message')).waitFor();
  assert.deepEqual(await list(), at_first, 'the list');
  await page.evaluate(() => globalThis.changeMadeUp({ activity: 'none', state: 'idle', hold: false, message: '' }));
});

anywhere('RESET restores the modes at the start', async (page) => {
  await ready(page);
  await view(page, 'mdi');
  const modal = () => text(page, 'modal');
  for (const block of ['G91', 'M3 S800']) {
    await page.locator(at('mdi-block')).fill(block);
    await page.locator(`${at('mdi-run')}:enabled`).click();
    await until(block, async () => ((await page.locator(at('mdi-block')).inputValue()) === '' && (await text(page, 'state')) === 'Ready') || text(page, 'state'));
  }
  await until('G91', async () => /G91( |$)/.test(await modal()) || modal());
  await page.locator(at('reset')).click();
  await until('G90', async () => /G90/.test(await modal()) || modal());
  assert.doesNotMatch(await modal(), /G91( |$)/);
  assert.match(await text(page, 'spindle'), /^0 /);
});

anywhere('one axis is homed, and the others stay', async (page, context) => {
  await takeControl(page);
  await powerTo(page, 'Ready');
  await view(page, 'jog');
  if (context.real) await ready(page);
  else await until('not homed', async () => (await page.locator('.homed.no').count()) === 3);
  await page.locator('button:has-text("Machine")').first().click();
  await page.locator(at('increment-1')).click();
  const places = async () => [await number(page, 'large-X'), await number(page, 'large-Y')];
  const settle = () => until('at rest', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
  const before = await places();
  for (const [i, letter] of ['X', 'Y'].entries()) {
    await page.locator(`${at(`jog-${letter}-plus`)}:enabled`).click();
    await until(`${letter} + 1`, async () => Math.abs((await places())[i] - before[i] - 1) < 0.0015 || places());
    await settle();
  }
  const [, y] = await places();
  await page.locator(`${at('home-X')}:enabled`).click();
  if (context.real) {
    // Without a home switch the core takes the command and the axis has nothing to do.
    await settle();
    await view(page, 'events');
    await until('HOME', async () => /HOME by page \d+$/m.test(await text(page, 'events')) || text(page, 'events'));
    return;
  }
  await until('X at home', async () => (await places())[0] === 0 || places(), 20_000);
  await settle();
  assert.equal((await places())[1], y, 'Y stays');
  assert.equal(await page.locator('.homed.no').count(), 2, 'X alone is homed');
});
