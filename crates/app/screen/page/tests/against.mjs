// The cases against a page that somebody serves: `node tests/against.mjs URL [CASE]`.
import { launch } from './browser.mjs';
import { runCases } from './run.mjs';

const [url, only = ''] = process.argv.slice(2);
if (url === undefined) throw new Error('node tests/against.mjs URL [CASE]');
const browser = await launch();
if (browser === null) {
  console.log('not measured: no Chromium (Debian: apt-get install chromium)');
  process.exit(0);
}
const failed = await runCases(browser, url, only, { real: true });
await browser.close();
process.exit(failed === 0 ? 0 : 1);
