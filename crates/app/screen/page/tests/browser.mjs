// Debian's Chromium, or none: tests that need a browser say "not measured" without one.
import { createHash, X509Certificate } from 'node:crypto';
import { existsSync, readFileSync } from 'node:fs';
import { chromium } from 'playwright-core';

const places = [process.env.EVOLVENT_CHROMIUM, '/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'];

function options() {
  return {
    executablePath: places.find((path) => path && existsSync(path)),
    // Software rendering, as on a machine without a graphics card; no sandbox only where root runs it, as in a container.
    args: ['--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', ...(process.getuid?.() === 0 ? ['--no-sandbox'] : [])],
  };
}

/** `certificate`: the file of one that is trusted by its key and nothing else, as if the operator had confirmed it. */
export async function launch(certificate) {
  const { executablePath, args } = options();
  if (executablePath === undefined) return null;
  if (certificate === undefined) return chromium.launch({ executablePath, args });
  const key = new X509Certificate(readFileSync(certificate)).publicKey.export({ type: 'spki', format: 'der' });
  const pin = createHash('sha256').update(key).digest('base64');
  return chromium.launch({ executablePath, args: [...args, `--ignore-certificate-errors-spki-list=${pin}`] });
}

/** A browser whose processes are known. */
export async function launchServer() {
  const server = await chromium.launchServer(options());
  const browser = await chromium.connect(server.wsEndpoint());
  return { browser, pid: server.process().pid, close: () => server.close() };
}
