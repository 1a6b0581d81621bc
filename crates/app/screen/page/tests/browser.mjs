// Debian's Chromium, or none: tests that need a browser say "not measured" without one.
import { existsSync } from 'node:fs';
import { chromium } from 'playwright-core';

const places = [process.env.EVOLVENT_CHROMIUM, '/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'];

function options() {
  return {
    executablePath: places.find((path) => path && existsSync(path)),
    // Software rendering, as on a machine without a graphics card; no sandbox only where root runs it, as in a container.
    args: ['--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', ...(process.getuid?.() === 0 ? ['--no-sandbox'] : [])],
  };
}

export async function launch() {
  return options().executablePath === undefined ? null : chromium.launch(options());
}

/** A browser whose processes are known. */
export async function launchServer() {
  const server = await chromium.launchServer(options());
  const browser = await chromium.connect(server.wsEndpoint());
  return { browser, pid: server.process().pid, close: () => server.close() };
}
