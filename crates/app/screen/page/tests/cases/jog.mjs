// Jogs: by buttons, keys and the pad.
import assert from 'node:assert/strict';
import { at, number, press, ready, rests, text, until, view } from '../operator.mjs';
import { anywhere, onMachine, onMadeUp } from '../case.mjs';
import { Watcher } from '../watcher.mjs';

anywhere('the jog view keeps distance and speed, and a page that was loaded begins with the smallest distance', async (page) => {
  await ready(page);
  await view(page, 'jog');
  const chosen = () => page.locator('[data-test^="increment-"][aria-pressed="true"]').evaluateAll((list) => list.map((button) => button.dataset.test).join());
  assert.equal(await chosen(), 'increment-0.001');
  await page.locator(at('increment-0.01')).click();
  await page.locator(at('jog-speed')).fill('37');
  await view(page, 'program');
  await view(page, 'jog');
  assert.deepEqual([await chosen(), await page.locator(at('jog-speed')).inputValue()], ['increment-0.01', '37']);
  // A press that stays on the button is still a hundredth.
  await page.locator('button:has-text("Machine")').first().click();
  const before = await number(page, 'large-X');
  await press(page, 'jog-X-plus');
  await page.waitForTimeout(400);
  await page.mouse.up();
  await until('X + 0.01', async () => Math.abs((await number(page, 'large-X')) - before - 0.01) < 0.0015 || number(page, 'large-X'));
  await page.locator(at('increment-0')).click();
  await page.reload();
  await page.locator(at('lease')).waitFor();
  await view(page, 'jog');
  assert.equal(await chosen(), 'increment-0.001', 'never one that goes on');
});

anywhere('a jog ends when the button is released, left, or the page loses its eyes', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  const ends = {
    released: () => page.mouse.up(),
    left: () => page.mouse.move(5, 300),
    blurred: () => page.evaluate(() => window.dispatchEvent(new Event('blur'))),
    hidden: () =>
      page.evaluate(() => {
        Object.defineProperty(document, 'hidden', { value: true, configurable: true });
        document.dispatchEvent(new Event('visibilitychange'));
        delete document.hidden;
      }),
    cancelled: () => page.locator(at('jog-X-plus')).evaluate((button) => button.dispatchEvent(new PointerEvent('pointercancel', { pointerId: 1, bubbles: true }))),
  };
  for (const [how, end] of Object.entries(ends)) {
    const before = await number(page, 'large-X');
    await press(page, how === 'left' ? 'jog-X-minus' : 'jog-X-plus');
    await until(`${how}: X moves`, async () => (await number(page, 'large-X')) !== before);
    await end();
    await rests(page, 'X');
    await until(`${how}: jog over`, async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
    await page.mouse.up();
  }
});

onMachine('the watcher of the campaigns reads samples as the server writes them', async (page) => {
  if (!page.url().startsWith('http:')) return 'not measured';
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  await page.locator('button:has-text("Machine")').first().click();
  const watcher = await Watcher.open(page.url());
  const before = await number(page, 'large-X');
  await press(page, 'jog-X-plus');
  await until('X + 1', async () => (await number(page, 'large-X')) > before + 1 || number(page, 'large-X'));
  await page.mouse.up();
  await rests(page, 'X');
  await until('where the page says', async () => Math.abs(watcher.newest.position - (await number(page, 'large-X'))) < 0.001 || watcher.newest.position);
  const { samples } = watcher;
  watcher.close();
  // Positions in f32, of setpoints that follow each other; of a frame that was lost there are none.
  const pairs = samples.slice(1).map((now, i) => [samples[i], now, now.time - samples[i].time]).filter(([, , step]) => step < 0.0045);
  const wrong = pairs.filter(([from, to, step]) => !(step > 0 && Math.abs(to.position - from.position - (step * (from.velocity + to.velocity)) / 2) < 1e-3));
  assert.deepEqual(wrong, []);
  assert.ok(pairs.length > 100 && pairs.some(([, { velocity }]) => velocity > 1), `${pairs.length} pairs`);
});

onMadeUp('a jog that somebody else has stopped, or that lost its page, needs a new press', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  const sent = (name) => page.evaluate((name) => globalThis.madeUpCommands.filter((command) => command === name).length, name);
  const ends = {
    stopped: () => page.evaluate(() => globalThis.changeMadeUp({ activity: 'none', state: 'idle', velocity: [0, 0, 0] })),
    blurred: () => page.evaluate(() => window.dispatchEvent(new Event('blur'))),
  };
  for (const [how, end] of Object.entries(ends)) {
    const box = await press(page, 'pad');
    const [x, y, radius] = [box.x + box.width / 2, box.y + box.height / 2, box.width / 2];
    const to = (i) => page.mouse.move(x + radius * (0.5 + 0.03 * i), y);
    await to(0);
    await until(`${how}: a jog`, async () => (await text(page, 'state')) === 'Jog' || text(page, 'state'));
    await page.waitForTimeout(300);
    await end();
    await until(`${how}: over`, async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
    // What was on its way is here.
    await page.waitForTimeout(100);
    const before = await sent('jog');
    for (let i = 1; i < 8; i += 1) {
      await to(i);
      await page.waitForTimeout(70);
    }
    assert.equal(await sent('jog'), before, `${how}: the finger that stays starts a jog`);
    assert.equal(await text(page, 'state'), 'Ready', how);
    await page.mouse.up();
  }
  // A new press jogs again, through the middle, too.
  const box = await press(page, 'pad');
  const [x, y, radius] = [box.x + box.width / 2, box.y + box.height / 2, box.width / 2];
  for (const fraction of [0.5, 0, -0.5]) {
    await page.mouse.move(x + radius * fraction, y);
    await until(`at ${fraction}`, async () => (await text(page, 'state')) === (fraction === 0 ? 'Ready' : 'Jog') || text(page, 'state'));
  }
  await page.mouse.up();
});

onMadeUp('a button that is released while the mode changes sends no jog, and one that waited too long starts nothing', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  const sent = (name) => page.evaluate((name) => globalThis.madeUpCommands.filter((command) => command === name).length, name);
  const delay = (ms) => page.evaluate((ms) => globalThis.delayMadeUp('mode', ms), ms);
  const inAuto = async () => {
    await page.evaluate(() => globalThis.changeMadeUp({ mode: 'auto' }));
    await page.waitForTimeout(150);
  };
  await delay(400);
  await inAuto();
  await press(page, 'jog-X-plus');
  await page.mouse.up();
  await page.waitForTimeout(700);
  assert.deepEqual([await sent('mode') > 0, await sent('jog')], [true, 0], 'no jog after the finger is up');
  // A jog by a distance, a block of MDI and a program: within a second of the press or not at all.
  await delay(1200);
  await inAuto();
  await page.locator(at('increment-1')).click();
  const late = () => until('why', async () => /longer than 1 s/.test(await page.locator(at('advice')).innerText()) || page.locator(at('advice')).innerText());
  await page.locator(at('jog-X-plus')).click();
  await late();
  await view(page, 'mdi');
  await page.locator(at('mdi-block')).fill('G0 X1');
  await page.locator(`${at('mdi-run')}:enabled`).click();
  await late();
  await page.evaluate(() => globalThis.changeMadeUp({ mode: 'manual' }));
  await page.waitForTimeout(150);
  await page.locator(`${at('start')}:enabled`).click();
  await late();
  for (const name of ['jog_distance', 'mdi', 'start']) assert.equal(await sent(name), 0, name);
  await delay(0);
  await page.evaluate(() => globalThis.changeMadeUp({ mode: 'manual' }));
  await page.waitForTimeout(150);
  await page.locator(`${at('start')}:enabled`).click();
  await until('it runs', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
});

anywhere('an increment is exact, and touching off names the place', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-1')).click();
  await page.locator('button:has-text("Machine")').first().click();
  const before = await number(page, 'large-Y');
  await page.locator(at('jog-Y-plus')).click();
  await until('Y + 1', async () => Math.abs((await number(page, 'large-Y')) - before - 1) < 0.0015 || number(page, 'large-Y'));
  await until('at rest', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
  await page.locator('button:has-text("Work")').first().click();
  await page.locator(at('touch-Y')).click();
  await page.locator(at('touch-value')).fill('12,5');
  await page.locator(at('touch-ok')).click();
  await until('Y reads 12.5', async () => (await number(page, 'large-Y')) === 12.5 || number(page, 'large-Y'));
});

anywhere('arrow keys jog only while unlocked', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  const before = await number(page, 'large-X');
  await page.keyboard.down('ArrowRight');
  await page.waitForTimeout(300);
  await page.keyboard.up('ArrowRight');
  assert.equal(await number(page, 'large-X'), before, 'locked keys move nothing');
  await page.locator(at('keys')).click();
  await page.keyboard.down('ArrowRight');
  await until('X moves', async () => (await number(page, 'large-X')) > before);
  await page.keyboard.up('ArrowRight');
  await rests(page, 'X');
  await page.evaluate(() => window.dispatchEvent(new Event('blur')));
  await page.locator(`${at('keys')}[aria-pressed="false"]`).waitFor();
});

onMadeUp('a jog that a key holds ends with any other key and with any release', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  await page.locator(at('keys')).click();
  const jogs = (what) => until(`${what}: a jog`, async () => (await text(page, 'state')) === 'Jog' || text(page, 'state'));
  const ends = (what) => until(`${what}: over`, async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 2000);
  const keyboard = page.keyboard;
  // The 6 of a keypad is an arrow, until Shift or NumLock makes a digit of it: its release is that of a digit.
  const told = (type, key, code) => page.evaluate((words) => window.dispatchEvent(new KeyboardEvent(words[0], { key: words[1], code: words[2], bubbles: true })), [type, key, code]);
  await told('keydown', 'ArrowRight', 'Numpad6');
  await jogs('keypad');
  await told('keyup', '6', 'Numpad6');
  await ends('a digit now');
  // Of what is released while Cmd is down macOS tells nothing: the press of Cmd ends the jog.
  for (const other of ['Meta', 'Shift', 'Control', 'NumLock', 'a']) {
    await keyboard.down('ArrowRight');
    await jogs(other);
    await keyboard.down(other);
    await ends(other);
    // The key that is still down repeats, and jogs no more.
    await keyboard.up(other);
    await keyboard.down('ArrowRight');
    await page.waitForTimeout(100);
    assert.equal(await text(page, 'state'), 'Ready', other);
    await keyboard.up('ArrowRight');
  }
  // Any release.
  await keyboard.down('ArrowRight');
  await jogs('any release');
  await told('keyup', 'q', 'KeyQ');
  await ends('any release');
  await keyboard.up('ArrowRight');
  // Space on a button is no other.
  await page.locator(at('jog-X-plus')).focus();
  await keyboard.down('Space');
  await jogs('Space');
  await keyboard.down('Space');
  await page.waitForTimeout(200);
  assert.equal(await text(page, 'state'), 'Jog', 'a key that repeats holds on');
  await keyboard.down('Meta');
  await ends('Space');
  await keyboard.up('Meta');
  await keyboard.up('Space');
});

anywhere('the pad jogs two axes at once', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  const before = [await number(page, 'large-X'), await number(page, 'large-Y')];
  const box = await press(page, 'pad');
  await page.mouse.move(box.x + box.width * 0.2, box.y + box.height * 0.8, { steps: 4 });
  await until('X and Y move', async () => (await number(page, 'large-X')) < before[0] && (await number(page, 'large-Y')) < before[1]);
  await page.mouse.up();
  await rests(page, 'X');
  await rests(page, 'Y');
});

onMadeUp('a pad that is no longer shown moves nothing', async (page) => {
  await ready(page);
  await view(page, 'jog');
  const sent = () => page.evaluate(() => globalThis.madeUpCommands.filter((command) => command === 'jog').length);
  // Another finger, or a keyboard, presses meanwhile.
  const click = (selector) => page.evaluate((selector) => document.querySelector(selector).click(), selector);
  for (const selector of ['[data-test="increment-0.1"]', '[data-view="mdi"]']) {
    await view(page, 'jog');
    await page.locator(at('increment-0')).click();
    const box = await press(page, 'pad');
    const [x, y, radius] = [box.x + box.width / 2, box.y + box.height / 2, box.width / 2];
    await page.mouse.move(x + radius * 0.5, y);
    await until('a jog', async () => (await text(page, 'state')) === 'Jog' || text(page, 'state'));
    // A change of direction waits for its turn.
    await page.evaluate(
      ([x, y, selector]) => {
        const pad = document.querySelector('[data-test="pad"]');
        for (let i = 1; i < 5; i += 1) pad.dispatchEvent(new PointerEvent('pointermove', { pointerId: 1, clientX: x - 5 * i, clientY: y, bubbles: true }));
        document.querySelector(selector).click();
        globalThis.jogsThen = globalThis.madeUpCommands.filter((command) => command === 'jog').length;
      },
      [x, y, selector],
    );
    await until(`${selector}: over`, async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 2000);
    await page.waitForTimeout(300);
    assert.equal(await sent(), await page.evaluate(() => globalThis.jogsThen), selector);
    await page.mouse.up();
  }
  // A button of an axis, too: the distance is chosen while it is held.
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  await press(page, 'jog-X-plus');
  await until('a jog', async () => (await text(page, 'state')) === 'Jog' || text(page, 'state'));
  await click('[data-test="increment-0.1"]');
  await until('over', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 2000);
  await page.mouse.up();
  // Whoever lifts the finger where the pad does not hear of it.
  await page.locator(at('increment-0')).click();
  const box = await press(page, 'pad');
  await page.mouse.move(box.x + box.width * 0.75, box.y + box.height / 2);
  await until('a jog', async () => (await text(page, 'state')) === 'Jog' || text(page, 'state'));
  await page.evaluate(() => window.dispatchEvent(new PointerEvent('pointerup', { pointerId: 1 })));
  await until('lifted', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 2000);
  await page.mouse.up();
});
