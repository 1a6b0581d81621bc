// A page that stays open while what it shows ends: `node tests/ending.mjs URL TEXT...`. It says "open" when it shows the machine, and "ok" when
// its advice has had each of the texts, one after the other.
import { launch } from './browser.mjs';
import { at, text, until } from './cases.mjs';

const [url, ...texts] = process.argv.slice(2);
const browser = await launch();
if (browser === null) {
  console.log('not measured: no Chromium (Debian: apt-get install chromium)');
  process.exit(0);
}
const page = await (await browser.newContext({ viewport: { width: 1024, height: 600 }, locale: 'en' })).newPage();
await page.goto(url);
await page.locator(at('lease')).waitFor();
await until('a status', async () => (await text(page, 'state')) !== 'No data', 30_000);
console.log('open');
for (const wanted of texts) {
  await until(wanted, async () => (await text(page, 'advice')).includes(wanted) || text(page, 'advice'), 60_000);
}
// What is final stays.
await page.waitForTimeout(1500);
await until('it stays', async () => (await text(page, 'advice')).includes(texts.at(-1)) || text(page, 'advice'), 0);
await browser.close();
console.log('ok');
