// A machine that is served with its screen, and simulated drives if they are wanted, for pictures and campaigns.
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { until } from './operator.mjs';

export const root = new URL('../../../../../', import.meta.url).pathname;

let served = 0;

/** A bus that no other core uses: the machine keeps its name, which the page shows. */
export function ownBus() {
  served += 1;
  return ['--bus-prefix', `evolvent-screen-${process.pid}-${served}_`];
}

/**
 * Serves a shipped machine on a bus of its own, with pieces of its text replaced. `files` are written beside it, `options` (given the
 * folder) added to `serve`, `drives` to `bridge sim`, which does not run without them. It ends with `end`.
 */
export async function serve(binary, { machine = 'mill-3axis', changes = [], files = {}, options = () => [], drives = null }) {
  const folder = mkdtempSync(join(tmpdir(), 'evolvent-screen-'));
  const bus = ownBus();
  let text = readFileSync(join(root, 'config/machines', `${machine}.toml`), 'utf8');
  for (const [from, to] of changes) {
    assert.ok(text.includes(from), from);
    text = text.replace(from, to);
  }
  const file = join(folder, 'machine.toml');
  writeFileSync(file, text);
  for (const [named, body] of Object.entries(files)) writeFileSync(join(folder, named), body);
  const start = (words) => {
    const child = spawn(resolve(binary), words, { cwd: root });
    const said = { text: '' };
    for (const stream of [child.stdout, child.stderr]) stream.on('data', (data) => (said.text += data));
    // Where what uses it fails, it does not stay.
    process.on('exit', () => child.kill('SIGKILL'));
    return { child, said };
  };
  const { child, said } = start(['serve', '--machine', file, '--state', join(folder, 'state'), '--trace-limit', '1', '--screen=127.0.0.1:0', ...bus, ...options(folder)]);
  await until('the addresses', () => (said.text.match(/http:\S+/g) ?? []).length === 2 || said.text, 20_000);
  const [url, watch] = said.text.match(/http:\S+/g);
  const bridge = drives && start(['bridge', 'sim', '--machine', file, ...bus, ...drives(folder)]).child;
  return {
    url,
    watch,
    folder,
    pid: child.pid,
    async end() {
      const ended = (one) => new Promise((resolve) => (one.exitCode === null ? one.once('exit', resolve) : resolve(one.exitCode)));
      child.kill('SIGTERM');
      const code = await ended(child);
      if (bridge) {
        bridge.kill('SIGTERM');
        await ended(bridge);
      }
      rmSync(folder, { recursive: true });
      assert.ok([0, 3].includes(code), `exit code ${code}\n${said.text}`);
    },
  };
}
