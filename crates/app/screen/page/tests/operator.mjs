// What an operator does and sees at a page, in steps that cases share.
import assert from 'node:assert/strict';

/** The views of this machine. */
export const viewsOf = (page) => page.locator('[data-view]').evaluateAll((tabs) => [...new Set(tabs.map((tab) => tab.dataset.view))]);

export const at = (name) => `[data-test="${name}"]`;
export const text = async (page, name) => (await page.locator(at(name)).innerText()).trim();
export const number = async (page, name) => Number((await text(page, name)).replace(/[^0-9.+-]/g, ''));

/** Waits until `test` gives true; says what it saw last where it does not. */
export async function until(what, test, ms = 10_000) {
  const end = Date.now() + ms;
  for (;;) {
    const seen = await test();
    if (seen === true) return;
    if (Date.now() > end) assert.fail(`${what}; last seen: ${JSON.stringify(seen)}`);
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
}

export const view = (page, name) => page.locator(`[data-view="${name}"]`).first().click();

export async function takeControl(page) {
  if ((await page.locator(at('lease')).getAttribute('aria-pressed')) !== 'true') await page.locator(at('lease')).click();
  await page.locator(`${at('lease')}[aria-pressed="true"]`).waitFor();
}

export async function powerTo(page, state) {
  await until(`state ${state}`, async () => {
    const seen = await text(page, 'state');
    if (seen === state) return true;
    if (!(await page.locator(at('power')).isDisabled())) await page.locator(at('power')).click();
    await page.waitForTimeout(150);
    return seen;
  });
}

export async function ready(page) {
  await takeControl(page);
  await powerTo(page, 'Ready');
  await page.locator(at('home')).click();
  await until('homed', async () => ((await page.locator('.homed.no').count()) === 0 && (await text(page, 'state')) === 'Ready') || text(page, 'state'), 60_000);
}

/** Watches X for `ms`: does it move? */
export async function moves(page, letter, ms = 150) {
  const before = await number(page, `large-${letter}`);
  await page.waitForTimeout(ms);
  return (await number(page, `large-${letter}`)) !== before;
}

export async function rests(page, letter) {
  await until(`${letter} at rest`, async () => !(await moves(page, letter)), 3000);
}

export async function press(page, name) {
  const box = await page.locator(at(name)).boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  return box;
}

/** A square from (0, 0) to (`side`, `side`): the first move is line 2, the right edge line 3. */
export function square(side, feed) {
  return `G21 G90 G17 G54 G94\nG1 X${side} Y0 F${feed}\nG1 X${side} Y${side}\nG1 X0 Y${side}\nG1 X0 Y0\nM2\n`;
}

export async function upload(page, name, body) {
  await view(page, 'program');
  await page.locator(at('program-file')).setInputFiles({ name, mimeType: 'text/plain', buffer: Buffer.from(body) });
  await until(`${name} loaded`, async () => (await page.locator('.top .name').count()) === 1 && (await page.locator('.top .name').innerText()) === name);
}
