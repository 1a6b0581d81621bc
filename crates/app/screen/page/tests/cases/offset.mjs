// Work offsets and tools.
import assert from 'node:assert/strict';
import { at, ready, text, until, view } from '../operator.mjs';
import { onMachine, onMadeUp } from '../case.mjs';

onMadeUp('a number that is half typed is set by Enter or the tick only', async (page) => {
  await ready(page);
  await view(page, 'offsets');
  const cell = page.locator(at('offset-G54-X'));
  const sent = () => page.evaluate(() => globalThis.madeUpCommands.filter((command) => command === 'work_offset').length);
  const given = async (value) => {
    await cell.fill(value);
    await page.locator(at('offset-G54-X-set')).waitFor();
  };
  await given('1');
  await cell.blur();
  await page.locator(at('offset-G54-X-set')).waitFor({ state: 'detached' });
  assert.deepEqual([await sent(), await cell.inputValue()], [0, ''], 'leaving the field');
  // The window loses the keyboard: what was typed stays, and stays unsent.
  await given('12');
  await page.evaluate(() => {
    document.hasFocus = () => false;
    document.activeElement.dispatchEvent(new FocusEvent('blur'));
    delete document.hasFocus;
  });
  assert.deepEqual([await sent(), await cell.inputValue()], [0, '12'], 'the window loses the keyboard');
  // Somebody else starts a program: the field is off, and what was typed is gone.
  await page.evaluate(() => globalThis.changeMadeUp({ activity: 'program', state: 'running' }));
  await until('off', () => cell.isDisabled());
  await page.evaluate(() => globalThis.changeMadeUp({ activity: 'none', state: 'idle' }));
  await until('on', async () => !(await cell.isDisabled()));
  assert.deepEqual([await sent(), await cell.inputValue()], [0, ''], 'a program runs');
  await given('12.5');
  await page.locator(at('offset-G54-X-set')).click();
  await until('the tick', async () => (await sent()) === 1 || sent());
  await given('13');
  await page.keyboard.press('Enter');
  await until('Enter', async () => (await sent()) === 2 || sent());
  await given('14');
  await page.keyboard.press('Escape');
  await page.waitForTimeout(100);
  assert.equal(await sent(), 2, 'Esc');
});

onMadeUp('a rotated work system says so', async (page) => {
  await view(page, 'offsets');
  await page.evaluate(() => globalThis.tellMadeUp({ kind: 'offsets', offsets: [{ system: 1, values: [0, 0, 0], rotation: 0 }, { system: 2, values: [0, 0, 0], rotation: 30 }] }));
  await until('R', async () => (await text(page, 'offset-G55-R')) === '30.000' || text(page, 'offset-G55-R'));
  assert.equal(await text(page, 'offset-G54-R'), '–');
});

onMachine('an offset and a tool are set where they stand in their tables', async (page) => {
  await ready(page);
  await view(page, 'offsets');
  await page.locator(at('offset-G54-X')).fill('33,25');
  await page.keyboard.press('Enter');
  await until('the offset', async () => /33\.250/.test(await page.locator('tfoot').innerText()) || page.locator('tfoot').innerText());
  await page.locator(at('offset-G54-X')).fill('0');
  await page.keyboard.press('Enter');
});
