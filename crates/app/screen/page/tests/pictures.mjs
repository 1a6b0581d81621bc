// Pictures of every view for the docs: `node tests/pictures.mjs URL FOLDER [LATHE_URL]`, where a machine is up and idle, and a lathe with a process file and
// a case of chatter.
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { launch } from './browser.mjs';
import { at, ready, takeControl, until, view } from './cases.mjs';

const [url, folder, lathe] = process.argv.slice(2);
if (folder === undefined) throw new Error('node tests/pictures.mjs URL FOLDER');
const browser = await launch();
const program = new URL('../../../../../tests/programs/bore-200.ngc', import.meta.url);

async function open(width, height, language, theme) {
  const context = await browser.newContext({ viewport: { width, height }, locale: language, colorScheme: theme });
  const page = await context.newPage();
  await page.goto(url);
  return page;
}

const page = await open(1024, 600, 'en', 'light');
await page.locator(at('estop')).click();
await page.waitForTimeout(500);
await ready(page);
await view(page, 'program');
await page.locator(at('program-file')).setInputFiles({ name: 'bore-200.ngc', mimeType: 'text/plain', buffer: readFileSync(program) });
await until('planned', async () => (await page.locator(at('planned')).count()) === 1, 30_000);
await view(page, 'path');
await page.waitForTimeout(4000);
// A slow host may have disconnected the page while it drew.
await takeControl(page);
await page.locator(at('start')).click();
await page.waitForTimeout(9000);
for (const name of ['path', 'program', 'scope', 'jog', 'mdi', 'offsets', 'tools', 'events']) {
  await view(page, name);
  await page.waitForTimeout(1800);
  await page.screenshot({ path: join(folder, `screen-${name}.png`) });
}
if (!(await page.locator(at('stop')).isDisabled())) await page.locator(at('stop')).click();
await until('rest', async () => (await page.locator(at('stop')).isDisabled()) === true, 20_000);
await page.waitForTimeout(600);
await view(page, 'path');
await page.locator(at('path-by-limit')).click();
await page.waitForTimeout(1500);
await page.screenshot({ path: join(folder, 'screen-limits.png') });
await view(page, 'traces');
await page.locator(at('trace-list')).locator('button').first().click();
await page.locator(at('trace-readout')).waitFor({ timeout: 60_000 });
const [from, to] = await page.locator(at('trace-scrub')).evaluate((element) => [Number(element.min), Number(element.max)]);
await page.locator(at('trace-scrub')).fill(String(Math.round(from + 0.6 * (to - from))));
await page.waitForTimeout(1500);
await page.screenshot({ path: join(folder, 'screen-traces.png') });
await takeControl(page);
await view(page, 'program');
await page.locator('[data-line="12"]').click();
await page.locator(at('run-from')).click();
await page.locator(`${at('run-from-way')} li`).first().waitFor();
await page.screenshot({ path: join(folder, 'screen-start-at.png') });
if (lathe !== undefined) await cut();
await page.close();
const wide = await open(1920, 1080, 'de', 'dark');
await view(wide, 'program');
await wide.waitForTimeout(8000);
await wide.screenshot({ path: join(folder, 'screen-wide.png') });
await browser.close();

async function cut() {
  const own = await browser.newContext({ viewport: { width: 1024, height: 600 }, locale: 'en', colorScheme: 'light' });
  const turning = await own.newPage();
  await turning.goto(lathe);
  await turning.locator(at('lease')).waitFor();
  await ready(turning);
  await view(turning, 'mdi');
  // Passes of a roughing job, as its program drives them.
  const passes = [9, 8, 7].flatMap((height) => [`G0 X${30 + height}`, 'G1 Z260 F6000', `G0 X${42}`, 'G0 Z302']);
  for (const block of ['G18 G21 G90 G94 G8', 'G0 X42', 'G0 Z302', 'M3 S5200', ...passes, `G0 X${36}`, 'G1 Z280 F6000']) {
    await turning.locator(at('mdi-block')).fill(block);
    await turning.locator(at('mdi-run')).click();
    await until(block, async () => (await turning.locator(at('mdi-block')).inputValue()) === '' && (await turning.locator(at('state')).innerText()).trim() === 'Ready', 20_000);
  }
  await view(turning, 'cut');
  await turning.waitForTimeout(1500);
  await turning.screenshot({ path: join(folder, 'screen-turning.png') });
  await turning.locator(at('cut-chatter')).click();
  await until('limits', async () => /stable/.test(await turning.locator(at('chatter-here')).innerText()), 60_000);
  await turning.waitForTimeout(600);
  await turning.screenshot({ path: join(folder, 'screen-chatter.png') });
}
