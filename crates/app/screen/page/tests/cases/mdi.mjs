// Blocks of MDI and macros.
import assert from 'node:assert/strict';
import { at, number, ready, text, until, view } from '../operator.mjs';
import { anywhere, onMachine, onMadeUp } from '../case.mjs';

onMadeUp('a block of MDI that is entered twice runs once', async (page) => {
  await ready(page);
  await view(page, 'mdi');
  const sent = () => page.evaluate(() => globalThis.madeUpCommands.filter((name) => name === 'mdi').length);
  const block = page.locator(at('mdi-block'));
  await page.evaluate(() => globalThis.delayMadeUp('mdi', 300));
  await block.fill('G91 G0 X1');
  await block.press('Enter');
  await block.press('Enter');
  await page.locator('.entry').first().click();
  await block.press('Enter');
  assert.equal(await page.locator(at('mdi-run')).isDisabled(), true, 'the button, too');
  await page.waitForTimeout(500);
  assert.equal(await sent(), 1);
  // After its answer, and after a rejection, the next one runs.
  await page.evaluate(() => globalThis.delayMadeUp('mdi', 0));
  await block.fill('G91 G0 X1');
  await page.locator(`${at('mdi-run')}:enabled`).click();
  await until('the second', async () => (await sent()) === 2 || sent());
  await page.evaluate(() => globalThis.rejectMadeUp('no'));
  await block.fill('G91 G0 X1');
  await page.locator(`${at('mdi-run')}:enabled`).click();
  await until('the third', async () => (await sent()) === 3 || sent());
  await page.locator(`${at('mdi-run')}:enabled`).waitFor();
});

anywhere('Tab completes a block of MDI, and so does a press', async (page) => {
  await view(page, 'mdi');
  const block = page.locator(at('mdi-block'));
  await block.pressSequentially('g54 G53');
  await page.keyboard.press('Tab');
  assert.equal(await block.inputValue(), 'g54 G53 G0');
  await block.fill('M6');
  await page.locator('.completions button', { hasText: 'M6 T' }).click();
  assert.equal(await block.inputValue(), 'M6 T');
  assert.equal(await block.evaluate((element) => element === document.activeElement), true);
  // Shift and Tab leave the field, as everywhere.
  await page.keyboard.press('Shift+Tab');
  assert.equal(await block.evaluate((element) => element === document.activeElement), false);
});

onMachine('a block of MDI is run, kept, and rejected with its reason', async (page) => {
  await ready(page);
  await view(page, 'mdi');
  await page.locator('button:has-text("Machine")').first().click();
  await page.locator(at('mdi-block')).fill('G53 G0 X12.5 Y-3');
  await page.keyboard.press('Enter');
  await until('X 12.5', async () => (await number(page, 'large-X')) === 12.5 || number(page, 'large-X'));
  await until('ready', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
  await page.locator(at('mdi-block')).fill('G1 X0 F');
  // Enter does nothing while the button is disabled, as it is until the block before has ended.
  await page.locator(`${at('mdi-run')}:enabled`).waitFor();
  await page.keyboard.press('Enter');
  await until('the reason', async () => /F/.test(await page.locator('[role=alert]').innerText()) || page.locator('[role=alert]').innerText());
  await page.locator(at('mdi-block')).fill('');
  await page.keyboard.press('ArrowUp');
  await page.keyboard.press('ArrowUp');
  assert.equal(await page.locator(at('mdi-block')).inputValue(), 'G53 G0 X12.5 Y-3');
  await page.reload();
  await view(page, 'mdi');
  assert.ok((await page.locator('.entry').allInnerTexts()).includes('G53 G0 X12.5 Y-3'), 'the history survives a reload');
});

onMachine('macros run block by block, are asked for, and end where a block is rejected', async (page, context) => {
  const park = '[[macro]]\nname = "Park"\nnote = "out of the way"\nblocks = ["G53 G0 X10", "G53 G0 Y5", "G53 G0 X0 Y0"]\n';
  context.macros(park + '[[macro]]\nname = "Ask"\nconfirm = true\nblocks = ["G53 G0 X3"]\n[[macro]]\nname = "Wrong"\nblocks = ["G53 G0 X1", "G1 Q", "G53 G0 X50"]\n');
  await ready(page);
  await view(page, 'mdi');
  await page.locator('button:has-text("Machine")').first().click();
  await page.locator('[data-macro="Park"]').click();
  await until('block 2', async () => /block [23] of 3/.test(await text(page, 'macros')) || text(page, 'macros'));
  await until('its end', async () => ((await number(page, 'large-X')) === 0 && (await number(page, 'large-Y')) === 0 && !/block/.test(await text(page, 'macros'))) || text(page, 'macros'));
  await page.locator('[data-macro="Ask"]').click();
  assert.equal(await number(page, 'large-X'), 0, 'nothing moves before the answer');
  await page.locator(at('macro-ok')).click();
  await until('X 3', async () => (await number(page, 'large-X')) === 3 || number(page, 'large-X'));
  await until('ready', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
  await page.locator('[data-macro="Wrong"]').click();
  await until('its fault', async () => /Wrong ended at block 2/.test(await text(page, 'macros')) || text(page, 'macros'));
  await page.waitForTimeout(300);
  assert.equal(await number(page, 'large-X'), 1, 'no block behind the one that was rejected');
  // Read again when it changes; what is wrong is told with its place.
  context.macros(`${park}blocks = 3\n`);
  await until('the problem', async () => ((await page.locator(at('macros-problem')).count()) === 1 && /macros\.toml:5/.test(await text(page, 'macros-problem'))) || page.locator(at('macros')).innerText());
  assert.equal(await page.locator('[data-macro]').count(), 0);
  context.macros('');
  await until('gone', async () => (await page.locator(at('macros')).count()) === 0);
}, 'macros');
