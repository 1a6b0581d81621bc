// A page that stays open while what it shows ends: `node tests/ending.mjs URL TEXT...`. It says "open" when it shows the machine, each of the
// texts when its advice has it, one after the other, and "ok" when the last one stays.
import { launch } from './browser.mjs';
import { at, text, until } from './operator.mjs';
import { LOADED_MS } from './run.mjs';

const [url, ...texts] = process.argv.slice(2);
const browser = await launch();
if (browser === null) {
  console.log('not measured: no Chromium (Debian: apt-get install chromium)');
  process.exit(0);
}
const page = await (await browser.newContext({ viewport: { width: 1024, height: 600 }, locale: 'en' })).newPage();
await page.goto(url, { timeout: LOADED_MS });
await page.locator(at('lease')).waitFor({ timeout: LOADED_MS });
await until('a status', async () => (await text(page, 'state')) !== 'No data', 30_000);
console.log('open');
for (const wanted of texts) {
  await until(wanted, async () => (await text(page, 'advice')).includes(wanted) || text(page, 'advice'), 60_000);
  console.log(wanted);
}
// What is final stays.
await page.waitForTimeout(1500);
await until('it stays', async () => (await text(page, 'advice')).includes(texts.at(-1)) || text(page, 'advice'), 0);
await browser.close();
console.log('ok');
