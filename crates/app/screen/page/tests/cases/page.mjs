// What holds for every view: encryption, accessibility, sizes.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { launch } from '../browser.mjs';
import { at, press, ready, square, text, until, upload, view, viewsOf } from '../operator.mjs';
import { anywhere, onMachine, onMadeUp } from '../case.mjs';

const axeSource = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8');

onMachine('an encrypted page operates the machine where its certificate is trusted, and nowhere else', async (page) => {
  const url = page.url();
  assert.match(url, /^https:/);
  const sockets = [];
  page.on('websocket', (socket) => sockets.push(socket.url()));
  await page.reload();
  await ready(page);
  assert.deepEqual(sockets, [`${url.replace(/^https:/, 'wss:')}ws`]);
  const [cookie] = await page.context().cookies();
  assert.deepEqual([cookie.name, cookie.secure, cookie.httpOnly, cookie.sameSite], ['evolvent_page', true, true, 'Strict']);
  await upload(page, 'encrypted.ngc', square(10, 1000));
  // The key in the address is the credential.
  const wrong = await page.context().request.get(url.replace(/[0-9a-f]{32}/, '0'.repeat(32)), { ignoreHTTPSErrors: true });
  assert.equal(wrong.status(), 404);
  // Without encryption there is no answer, and so no key that anybody reads on its way is of use.
  await assert.rejects(page.goto(url.replace(/^https:/, 'http:')), /net::ERR_(EMPTY_RESPONSE|CONNECTION_RESET|INVALID_HTTP_RESPONSE)/);
  const stranger = await launch();
  try {
    await assert.rejects((await stranger.newPage()).goto(url), /net::ERR_CERT_AUTHORITY_INVALID/);
  } finally {
    await stranger.close();
  }
}, 'certificate');

onMadeUp('in either language the buttons of 1024 x 600 have one row, and their texts do not touch their edges', async (page) => {
  for (const language of ['en', 'de']) {
    await page.locator(at('menu')).click();
    await page.locator(`dialog[open] [lang="${language}"]`).click();
    await page.keyboard.press('Escape');
    await view(page, 'program');
    await page.evaluate(async () => ((await import('/src/lib/selection.svelte.ts')).selection.line = 123_456));
    await until('the line', async () => /123456/.test(await text(page, 'run-from')) || text(page, 'run-from'));
    const found = await page.evaluate(() => {
      const rows = [...document.querySelectorAll('.row.bottom, footer')].map((row) => new Set([...row.querySelectorAll('button')].map((button) => button.offsetTop)).size);
      const gap = (button) => {
        const range = document.createRange();
        range.selectNodeContents(button);
        const [text, box] = [range.getBoundingClientRect(), button.getBoundingClientRect()];
        return Math.min(text.left - box.left, box.right - text.right);
      };
      return { rows, tight: [...document.querySelectorAll('footer button')].filter((button) => gap(button) < 5).map((button) => button.innerText), isWide: document.documentElement.scrollWidth > innerWidth };
    });
    assert.deepEqual(found, { rows: [1, 1], tight: [], isWide: false }, language);
  }
});

anywhere('no serious fault of accessibility in any view, light or dark, in either language', async (page) => {
  for (const theme of ['light', 'dark']) {
    for (const language of ['en', 'de']) {
      await page.locator(at('menu')).click();
      await page.locator(`dialog[open] [lang="${language}"]`).click();
      await page.locator('dialog[open] [aria-pressed]').nth(theme === 'light' ? 2 : 3).click();
      await page.keyboard.press('Escape');
      for (const name of await viewsOf(page)) {
        await view(page, name);
        await page.waitForTimeout(150);
        // As a string: the policy of the page permits no eval, and needs none for what a debugger runs.
        // With its pad.
        if (name === 'jog') await page.locator(at('increment-0')).click();
        await page.evaluate(axeSource);
        const result = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ['violations'] }));
        const serious = result.violations.filter((violation) => ['serious', 'critical'].includes(violation.impact));
        assert.deepEqual(
          serious.map((violation) => `${violation.id}: ${violation.nodes.map((node) => node.html.slice(0, 120)).join(' | ')}`),
          [],
          `${name}, ${theme}, ${language}`,
        );
      }
    }
  }
});

anywhere('nothing is cut off from 1024 x 600 to 4K in either language', async (page) => {
  for (const [language, width, height] of [['de', 1024, 600], ['en', 1024, 600], ['de', 1500, 900], ['en', 1920, 1080], ['de', 1920, 1080], ['de', 3840, 2160]]) {
    await page.setViewportSize({ width, height });
    await page.locator(at('menu')).click();
    await page.locator(`dialog[open] [lang="${language}"]`).click();
    await page.keyboard.press('Escape');
    for (const name of await viewsOf(page)) {
      await view(page, name);
      await page.waitForTimeout(100);
      const faults = await page.evaluate(() => {
        const wide = [...document.querySelectorAll('button, .tabs, .values > div, dd, .pill')].filter(
          (element) => element.offsetParent !== null && element.scrollWidth > element.clientWidth + 1 && !element.matches('.entry, .tool-comment'),
        );
        const view = document.querySelector('.view');
        return {
          wide: wide.map((element) => `${element.className} ${element.textContent.trim().slice(0, 40)}: ${element.scrollWidth} > ${element.clientWidth}`),
          page: document.documentElement.scrollHeight > innerHeight || document.documentElement.scrollWidth > innerWidth,
          view: view.scrollHeight > view.clientHeight + 1 || view.scrollWidth > view.clientWidth + 1 ? `${view.scrollWidth}x${view.scrollHeight} > ${view.clientWidth}x${view.clientHeight}` : '',
        };
      });
      assert.deepEqual(faults, { wide: [], page: false, view: '' }, `${name}, ${language}, ${width} x ${height}`);
    }
  }
});

anywhere('what is operated stays where it is, whatever the machine does', async (page) => {
  const places = () =>
    page.evaluate(() =>
      Object.fromEntries(
        [...document.querySelectorAll('header button, footer button, .overrides button, [data-test^="large-"], [role="tab"]')].map((element) => {
          const box = element.getBoundingClientRect();
          return [element.dataset.test ?? element.textContent.trim(), [box.left, box.top, box.right, box.bottom].map(Math.round).join(' ')];
        }),
      ),
    );
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  const before = await places();
  await ready(page);
  assert.deepEqual(await places(), before, 'ready');
  await press(page, 'jog-X-plus');
  await page.waitForTimeout(200);
  assert.deepEqual(await places(), before, 'jogging');
  await page.mouse.up();
  await page.locator(at('estop')).click();
  await page.waitForTimeout(200);
  assert.deepEqual(await places(), before, 'stopped');
});
