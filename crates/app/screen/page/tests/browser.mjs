// Debian's Chromium, or none: tests that need a browser say "not measured" without one.
import { existsSync } from 'node:fs';
import { chromium } from 'playwright-core';

const places = [process.env.EVOLVENT_CHROMIUM, '/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'];

export async function launch() {
  const executablePath = places.find((path) => path && existsSync(path));
  if (executablePath === undefined) return null;
  return chromium.launch({
    executablePath,
    // Software rendering, as on a machine without a graphics card; no sandbox only where root runs it, as in a container.
    args: ['--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', ...(process.getuid?.() === 0 ? ['--no-sandbox'] : [])],
  });
}
