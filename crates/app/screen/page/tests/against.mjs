// The cases against a page that somebody serves: `node tests/against.mjs URL [CASE]`. With EVOLVENT_MACROS, the name of the service's file of
// macros, those of macros are measured, too; with EVOLVENT_WHEEL, a file of the counts of its handwheel, that the wheel is followed; with
// EVOLVENT_CERTIFICATE, the server's own certificate, that an encrypted page is; with EVOLVENT_CTL, a JSON list of the words of `evolvent ctl`
// before its action, what another client does is.
import { execFile } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { promisify } from 'node:util';
import { launch } from './browser.mjs';
import { runCases } from './run.mjs';

const [url, only = ''] = process.argv.slice(2);
if (url === undefined) throw new Error('node tests/against.mjs URL [CASE]');
const certificate = process.env.EVOLVENT_CERTIFICATE;
const browser = await launch(certificate);
if (browser === null) {
  console.log('not measured: no Chromium (Debian: apt-get install chromium)');
  process.exit(0);
}
const file = process.env.EVOLVENT_MACROS;
const macros = file ? (text) => writeFileSync(file, text) : undefined;
const wheel = process.env.EVOLVENT_WHEEL;
const turn = wheel ? async (counts) => writeFileSync(wheel, String(Number(readFileSync(wheel, 'utf8')) + counts)) : undefined;
const words = process.env.EVOLVENT_CTL ? JSON.parse(process.env.EVOLVENT_CTL) : null;
const ctl = words && ((...action) => promisify(execFile)(words[0], [...words.slice(1), ...action]));
const folder = mkdtempSync(join(tmpdir(), 'evolvent-page-'));
const write = (name, body) => (writeFileSync(join(folder, name), body), join(folder, name));
const remove = (name) => rmSync(join(folder, name));
const context = { real: true, macros, turn, certificate, ctl, write, remove };
const failed = await runCases(browser, url, context, ({ name, places }) => places.includes('machine') && name.includes(only));
await browser.close();
rmSync(folder, { recursive: true });
process.exit(failed === 0 ? 0 : 1);
