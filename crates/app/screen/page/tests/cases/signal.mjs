// Inputs, outputs and the handwheel.
import assert from 'node:assert/strict';
import { at, number, ready, text, until, view } from '../operator.mjs';
import { anywhere } from '../case.mjs';

anywhere('outputs are set by name, and each signal has its value', async (page, context) => {
  if ((await page.locator('[data-view="io"]').count()) === 0) return 'not measured';
  await ready(page);
  await view(page, 'io');
  await until('an input', async () => /D0\s+on/.test(await text(page, 'input-door-closed')) || text(page, 'input-door-closed'));
  const is = (name, value) => page.locator(`${at(`${value}-${name}`)}[aria-pressed="true"]`).waitFor();
  // With the finger, then with the keyboard.
  await page.locator(at('on-dust-extraction')).click();
  await is('dust-extraction', 'on');
  await page.locator(at('off-dust-extraction')).focus();
  await page.keyboard.press('Enter');
  await is('dust-extraction', 'off');
  const power = page.locator(at('value-laser-power'));
  await power.fill('7,5');
  await page.keyboard.press('Enter');
  await until('7.5', async () => (await power.inputValue()) === '7.500' || power.inputValue());
  // A value that the machine file does not permit is rejected, and the one in force is shown again.
  await power.fill('10.5');
  await page.keyboard.press('Enter');
  await page.locator(at('rejection')).waitFor();
  await until('7.5 again', async () => (await power.inputValue()) === '7.500' || power.inputValue());
  if (context.real) await until('the wheel', async () => /A3\s+123456/.test(await text(page, 'input-wheel')) || text(page, 'input-wheel'));
  // Who only watches sees them and sets nothing.
  await page.locator(at('lease')).click();
  await page.locator(`${at('on-dust-extraction')}:disabled`).waitFor();
  assert.equal(await power.isDisabled(), true);
});

anywhere('the handwheel moves the axis that is selected, by the step that is selected', async (page, context) => {
  if ((await page.locator('[data-view="io"]').count()) === 0) return 'not measured';
  await ready(page);
  await view(page, 'jog');
  const told = (what) => until(`${what}`, async () => what.test(await text(page, 'wheel-told')) || text(page, 'wheel-told'));
  await page.locator(at('wheel-none')).click();
  await told(/moves no axis/);
  // The step that is chosen first counts for the axis that is chosen then.
  await page.locator(at('wheel-step-1')).click();
  await page.locator(at('wheel-X')).focus();
  await page.keyboard.press('Enter');
  await told(/moves X by 0.01 mm/);
  await page.locator(at('wheel-step-2')).click();
  await told(/moves X by 0.1 mm/);
  await page.locator(`${at('wheel-step-2')}[aria-pressed="true"]`).waitFor();
  if (context.turn) {
    await page.locator('button:has-text("Machine")').first().click();
    const before = await number(page, 'large-X');
    // Ten detents of four counts.
    await context.turn(40);
    await until('X + 1', async () => Math.abs((await number(page, 'large-X')) - before - 1) < 0.0015 || number(page, 'large-X'));
    await page.locator(at('wheel-none')).click();
    await told(/moves no axis/);
    await context.turn(40);
    await page.waitForTimeout(400);
    assert.ok(Math.abs((await number(page, 'large-X')) - before - 1) < 0.0015, 'no axis is selected');
  }
  await page.locator(at('wheel-Z')).click();
  await told(/moves Z/);
  await page.locator(at('wheel-none')).click();
  await told(/moves no axis/);
});
