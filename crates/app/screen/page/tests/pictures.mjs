// Pictures of every view for the docs: `node tests/pictures.mjs URL FOLDER`, where a machine is up and idle.
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { launch } from './browser.mjs';
import { at, ready, until, view } from './cases.mjs';

const [url, folder] = process.argv.slice(2);
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
await page.locator(at('start')).click();
await page.waitForTimeout(9000);
for (const name of ['path', 'program', 'scope', 'jog', 'mdi', 'offsets', 'tools', 'events']) {
  await view(page, name);
  await page.waitForTimeout(1800);
  await page.screenshot({ path: join(folder, `screen-${name}.png`) });
}
const wide = await open(1920, 1080, 'de', 'dark');
await view(wide, 'program');
await wide.waitForTimeout(8000);
await wide.screenshot({ path: join(folder, 'screen-wide.png') });
if (!(await page.locator(at('stop')).isDisabled())) await page.locator(at('stop')).click();
await browser.close();
