// The cases against the made-up machine, without a core: `npm run test [CASE]`. With `--rest` only those that no machine can show, for a
// run beside one of `against.mjs`.
import { fileURLToPath } from 'node:url';
import { parseArgs } from 'node:util';
import { createServer } from 'vite';
import { launch } from './browser.mjs';
import { runCases } from './run.mjs';

const browser = await launch();
if (browser === null) {
  console.log('not measured: no Chromium (Debian: apt-get install chromium)');
  process.exit(0);
}
const server = await createServer({ root: fileURLToPath(new URL('..', import.meta.url)), server: { port: 0, host: '127.0.0.1' }, logLevel: 'error' });
await server.listen();
const url = `${server.resolvedUrls.local[0]}?made-up`;

/** Gives the made-up machine a program of `bytes`; says how many lines it has. */
async function program(page, bytes) {
  const line = 'N000000 G1 X123.456 Y-78.901 Z-12.345 F2500.0\n';
  const count = Math.floor(bytes / line.length);
  const body = Buffer.from(Array.from({ length: count }, (_, i) => line.replace('000000', String(i).padStart(6, '0'))).join(''));
  await page.route('**/made-up.ngc*', (route) => route.fulfill({ body, contentType: 'text/plain' }));
  await page.evaluate(() => globalThis.loadMadeUpText(`./made-up.ngc?${Math.random()}`));
  return count;
}

const { values, positionals } = parseArgs({ options: { rest: { type: 'boolean' } }, allowPositionals: true });
const chosen = ({ name, places }) => places.includes('made-up') && !(values.rest && places.includes('machine')) && name.includes(positionals[0] ?? '');
const failed = await runCases(browser, url, { program }, chosen);
await browser.close();
await server.close();
process.exit(failed === 0 ? 0 : 1);
