// Stops of every kind.
import assert from 'node:assert/strict';
import { at, moves, powerTo, press, ready, text, until, view, viewsOf } from '../operator.mjs';
import { anywhere, onMadeUp } from '../case.mjs';

onMadeUp('STOP, Stop and Esc work whatever is open', async (page) => {
  await ready(page);
  await page.route('**/docs/**', (route) => route.fulfill({ body: '<p>made up</p>', contentType: 'text/html' }));
  const moves = () => page.evaluate(() => globalThis.changeMadeUp({ activity: 'program', state: 'running' }));
  const runs = () => until('it runs', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
  const stopped = (what) => until(`${what}: stopped`, async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 3000);
  const press = async (what, name) => {
    const box = await page.locator(at(name)).last().boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.click(x, y);
    await (name.endsWith('estop') ? until(`${what}: E-STOP`, async () => (await text(page, 'state')) === 'E-STOP' || text(page, 'state'), 3000) : stopped(`${what}, ${name}`));
  };
  const panels = {
    settings: () => page.locator(at('menu')).click(),
    'alarm-list': async () => {
      await page.evaluate(() => globalThis.raiseMadeUpAlarm(410));
      await page.locator(`${at('alarms')}:enabled`).click();
    },
    stock: async () => {
      await view(page, 'path');
      await page.locator(at('path-stock')).click();
    },
    help: async () => {
      await page.locator(at('menu')).click();
      await page.locator(at('help-open')).click();
      await page.locator(`${at('help')} iframe`).waitFor();
    },
  };
  for (const [name, open] of Object.entries(panels)) {
    await ready(page);
    await open();
    const panel = page.locator(`${at(name)}[open]`);
    await panel.waitFor();
    await moves();
    await runs();
    await press(name, 'stop');
    await moves();
    await runs();
    await page.keyboard.press('Escape');
    await stopped(`${name}, Esc`);
    await panel.waitFor({ state: 'hidden' });
    await page.evaluate(() => globalThis.changeMadeUp({ alarms: [], alarmText: '' }));
    await open();
    await press(name, 'estop');
    await page.keyboard.press('Escape');
    await page.evaluate(() => globalThis.changeMadeUp({ alarms: [], alarmText: '' }));
  }
  // A frame keeps its keys to itself: once something moves the page takes the keyboard back.
  await ready(page);
  await panels.help();
  const box = await page.locator(`${at('help')} iframe`).boundingBox();
  const focus = async () => {
    await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    return page.evaluate(() => document.activeElement.tagName);
  };
  // Its text comes after the frame, and a click before that is the page's.
  await until('the frame has the keyboard', async () => (await focus()) === 'IFRAME');
  await moves();
  await runs();
  await focus();
  await until('the keyboard', async () => (await page.evaluate(() => document.activeElement.tagName)) === 'BODY');
  await page.keyboard.press('Escape');
  await stopped('with a frame');
  // Where a dialog is modal it has both buttons.
  for (const [how, end] of [['dialog-stop', stopped], ['Esc', stopped], ['dialog-estop', () => until('E-STOP', async () => (await text(page, 'state')) === 'E-STOP')]]) {
    await ready(page);
    await view(page, 'jog');
    await page.locator(at('touch-X')).click();
    assert.equal(await page.evaluate(() => document.activeElement.dataset.test), 'touch-value', 'what opens is what is asked for');
    await moves();
    await runs();
    if (how === 'Esc') await page.keyboard.press('Escape');
    else await page.locator(`${at('touch-dialog')} ${at(how)}`).click();
    await end(how);
    await page.keyboard.press('Escape');
  }
  // All dialogs: those that are modal are those with the buttons.
  const without = await page.evaluate(() => [...document.querySelectorAll('dialog:not(.side)')].filter((dialog) => dialog.querySelector('[data-test="stops"]') === null).length);
  assert.equal(without, 0);
});

onMadeUp('a stop that nobody confirms says where to press', async (page) => {
  await ready(page);
  const told = page.locator(at('unconfirmed'));
  const delay = (name, ms) => page.evaluate(([name, ms]) => globalThis.delayMadeUp(name, ms), [name, ms]);
  await page.evaluate(() => globalThis.changeMadeUp({ activity: 'program', state: 'running' }));
  await page.locator(`${at('stop')}:enabled`).click();
  await page.waitForTimeout(700);
  assert.equal(await told.count(), 0, 'one that was answered');
  for (const [name, words] of [['stop', /^Stop is not confirmed. Use the emergency stop of the machine/], ['estop', /^STOP is not confirmed/]]) {
    await ready(page);
    await page.evaluate(() => globalThis.changeMadeUp({ activity: 'program', state: 'running' }));
    await delay(name, 2000);
    await page.locator(`${at(name)}:enabled`).click();
    await told.waitFor({ timeout: 1500 });
    assert.match(await told.innerText(), words);
    // What lies under it can be pressed, and its effect ends it.
    assert.equal(await told.evaluate((element) => getComputedStyle(element).pointerEvents), 'none');
    await told.waitFor({ state: 'detached', timeout: 4000 });
    await delay(name, 0);
  }
  // A dialog lies over it.
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('touch-X')).click();
  await delay('estop', 2000);
  await page.locator(`${at('touch-dialog')} ${at('dialog-estop')}`).click();
  await page.locator(`${at('touch-dialog')} [role="alert"]`).waitFor({ timeout: 1500 });
});

anywhere('STOP is in sight and takes effect at any width from 360 px', async (page) => {
  await ready(page);
  for (const [width, height] of [[360, 640], [390, 844], [600, 960], [768, 1024], [1024, 600]]) {
    await page.setViewportSize({ width, height });
    for (const name of await viewsOf(page)) {
      await view(page, name);
      const cut = () =>
        page.evaluate(() => {
          const inside = (element) => {
            const box = element.getBoundingClientRect();
            return box.left >= 0 && box.top >= 0 && box.right <= innerWidth + 0.5 && box.bottom <= innerHeight + 0.5;
          };
          const reached = (element) => {
            const box = element.getBoundingClientRect();
            return element.contains(document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2));
          };
          const always = [...document.querySelectorAll('[data-test="estop"], footer button')];
          const values = [...document.querySelectorAll('[data-test^="large-"], [data-test^="other-"], .values > div, .overrides button, .overrides input, footer button, .pill')];
          const tell = (element) => element.dataset.test ?? element.textContent.trim().slice(0, 30);
          return {
            outside: always.filter((element) => !inside(element) || !reached(element)).map(tell),
            cut: values.filter((element) => element.getBoundingClientRect().right > innerWidth + 0.5 || element.scrollWidth > element.clientWidth + 1 && element.clientWidth > 0).map(tell),
            wide: document.documentElement.scrollWidth > innerWidth,
          };
        });
      const nothing = { outside: [], cut: [], wide: false };
      assert.deepEqual(await cut(), nothing, `${name}, ${width} x ${height}`);
      // Also where the page is scrolled.
      await page.evaluate(() => scrollTo(0, document.documentElement.scrollHeight));
      assert.deepEqual((await cut()).outside, [], `${name}, ${width} x ${height}, scrolled`);
      await page.evaluate(() => scrollTo(0, 0));
    }
    const box = await page.locator(at('estop')).boundingBox();
    await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    await until(`E-STOP at ${width} px`, async () => (await text(page, 'state')) === 'E-STOP' || text(page, 'state'));
    await powerTo(page, 'Ready');
  }
});
