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

onMadeUp('no button of any view moves when a program is held, a block is rejected or another distance is chosen', async (page) => {
  await ready(page);
  await page.evaluate(() => {
    const macro = (name) => ({ name, note: '', blocks: ['G0 X1'], confirm: false });
    globalThis.tellMadeUp({ kind: 'macros', macros: ['Park', 'Probe', 'Warm up'].map(macro), problem: null });
  });
  const places = () =>
    page.evaluate(() => {
      const counts = new Map();
      const list = [...document.querySelectorAll('button, [role="tab"], input, select, [data-test^="large-"]')].filter((element) => element.offsetParent !== null);
      return Object.fromEntries(
        list.map((element) => {
          // A text may say the state; of elements without a name the order is compared.
          const name = element.dataset.test ?? element.dataset.macro ?? element.dataset.view ?? `${element.parentElement.className} ${element.tagName}`;
          counts.set(name, (counts.get(name) ?? 0) + 1);
          const box = element.getBoundingClientRect();
          return [`${name} ${counts.get(name)}`, [box.left, box.top, box.right, box.bottom].map(Math.round).join(' ')];
        }),
      );
    });
  const change = (changes) => page.evaluate((to) => globalThis.changeMadeUp(to), changes);
  const moved = (before, after) =>
    Object.entries(before)
      .filter(([name, place]) => name in after && after[name] !== place)
      .map(([name, place]) => `${name}: ${place} -> ${after[name]}`);
  const long = 'axis X would leave its travel, which ends at 400 mm; '.repeat(8);
  const rest = { activity: 'none', state: 'idle', hold: false, message: '', toolChange: 'none', alarms: [], alarmText: '', awayParts: 0, retraceBlocks: 0 };
  const states = {
    held: () => change({ activity: 'program', state: 'held', hold: true, retraceBlocks: 3 }),
    away: () => change({ awayParts: 2, message: `the way back: ${long}` }),
    'at a program stop': () => change({ ...rest, activity: 'program', state: 'program_stop', message: `clamp A closed?; ${long}` }),
    'at a tool change': () => change({ ...rest, activity: 'program', state: 'program_stop', toolChange: 'operator', toolWanted: 12345 }),
    rejected: async (name) => {
      await change(rest);
      await page.waitForTimeout(60);
      await page.evaluate((text) => globalThis.rejectMadeUp(text), long);
      if (name === 'mdi') {
        await page.locator(at('mdi-block')).fill('G0 X1000');
        await page.locator(at('mdi-run')).click();
        await until('its text', async () => (await text(page, 'mdi-error')) !== '');
        await page.locator('[data-macro="Park"]').click();
      } else await page.locator(at('home')).click();
      await page.locator(at('rejection')).waitFor();
      await page.evaluate(() => globalThis.rejectMadeUp(''));
    },
    alarmed: () => change({ ...rest, alarms: [410, 401], alarmText: long }),
    'in emergency stop': () => change({ ...rest, machineState: 'estop' }),
  };
  for (const name of await viewsOf(page)) {
    await change({ ...rest, machineState: 'on' });
    await view(page, name);
    await page.waitForTimeout(150);
    const before = await places();
    assert.ok(Object.keys(before).length > 25, `${name}: ${Object.keys(before)}`);
    for (const [state, enter] of Object.entries(states)) {
      await enter(name);
      await page.waitForTimeout(80);
      assert.deepEqual(moved(before, await places()), [], `${name}, ${state}`);
    }
    if (name !== 'jog') continue;
    for (const step of await page.locator('[data-test^="increment-"]').evaluateAll((list) => list.map((button) => button.dataset.test))) {
      await page.locator(at(step)).click();
      assert.deepEqual(moved(before, await places()), [], `jog, ${step}`);
    }
  }
});

onMadeUp('a page that may only watch offers no stop, and says where one is', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.evaluate(() => {
    globalThis.changeMadeUp({ activity: 'program', state: 'running' });
    globalThis.tellMadeUp({ kind: 'lease', lease: { mine: false, holder: null, readOnly: true } });
  });
  await until('it runs', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
  for (const name of ['estop', 'stop']) {
    assert.equal(await page.locator(at(name)).isDisabled(), true, name);
    assert.match(await page.locator(at(name)).getAttribute('title'), /only watch.*emergency stop of the machine/, name);
  }
  assert.match(await text(page, 'estop'), /not from here/);
  assert.doesNotMatch(await text(page, 'lease'), /Take/);
  const before = await page.evaluate(() => globalThis.madeUpCommands.length);
  await page.keyboard.press('Escape');
  // In a modal dialog, too.
  await page.evaluate(() => document.querySelector('[data-test="touch-dialog"]').showModal());
  for (const name of ['dialog-estop', 'dialog-stop']) {
    const button = page.locator(`${at('touch-dialog')} ${at(name)}`);
    assert.equal(await button.isDisabled(), true, name);
    assert.match(await button.getAttribute('title'), /only watch/, name);
  }
  await page.evaluate(() => document.querySelector('[data-test="touch-dialog"]').close());
  await page.locator(at('estop')).click({ force: true });
  await page.waitForTimeout(100);
  assert.deepEqual(await page.evaluate((count) => globalThis.madeUpCommands.slice(count), before), []);
  // A page that may command and does not can stop.
  await page.evaluate(() => globalThis.tellMadeUp({ kind: 'lease', lease: { mine: false, holder: 3, readOnly: false } }));
  await page.locator(at('estop')).click();
  await until('E-STOP', async () => (await text(page, 'state')) === 'E-STOP' || text(page, 'state'));
});

onMadeUp('Alt and a digit opens each view, also the tenth and the eleventh', async (page) => {
  await page.evaluate(() => globalThis.changeMadeUpMachine({ kind: 'lathe' }));
  await page.locator('[data-view="cut"]').waitFor();
  const names = await viewsOf(page);
  assert.equal(names.length, 11);
  const keys = ['1', '2', '3', '4', '5', '6', '7', '8', '9', '0', 'Minus'];
  for (const [i, key] of keys.entries()) {
    await page.keyboard.press(`Alt+${key === 'Minus' ? key : `Digit${key}`}`);
    await until(names[i], async () => {
      const chosen = await page.locator('[role="tab"][aria-selected="true"]').getAttribute('data-view');
      return chosen === names[i] || chosen;
    });
  }
});

onMadeUp('pill and sentence say the same of a job that begins or ends, and a program with errors does not turn the pill red', async (page) => {
  await ready(page);
  const both = async () => [await text(page, 'state'), await text(page, 'advice')];
  for (const [state, sentence] of [['idle', 'The job is being planned.'], ['running', 'Line 7 is running.'], ['done', 'The job is ending.'], ['stopped', 'The job is ending.']]) {
    await page.evaluate((to) => globalThis.changeMadeUp({ activity: 'mdi', state: to, line: 7 }), state);
    await until(state, async () => {
      const [word, said] = await both();
      return (word === 'MDI' && said === sentence) || [word, said];
    });
  }
  await page.evaluate(() => {
    globalThis.changeMadeUp({ activity: 'none', state: 'idle' });
    const error = { line: 3, column: 1, length: 2, code: 'G0101', message: 'made up', help: '', file: null };
    const program = { name: 'bad.ngc', upload: 2, file: 'bad.ngc', problem: null, bytes: 10, lines: 3, errors: [error], warnings: [], checked: true, plannedS: null };
    globalThis.tellMadeUp({ kind: 'program', program });
  });
  await until('the error', async () => /1 error/.test(await text(page, 'advice')) || both());
  assert.equal(await text(page, 'state'), 'Ready');
  assert.doesNotMatch(await page.locator(at('state')).getAttribute('class'), /bad/);
  assert.match(await page.locator(at('advice')).getAttribute('class'), /bad/);
});

onMadeUp('while no status comes the note about it covers no other text by half', async (page) => {
  await ready(page);
  await page.evaluate(() => globalThis.quietMadeUp(true));
  await page.locator(at('no-data')).waitFor();
  const covered = await page.evaluate(() => {
    const note = document.querySelector('[data-test="no-data"]');
    const box = note.getBoundingClientRect();
    return [...note.parentElement.querySelectorAll('span, button')]
      .filter((element) => getComputedStyle(element).visibility !== 'hidden' && element.textContent.trim() !== '')
      .filter((element) => {
        const other = element.getBoundingClientRect();
        return other.left < box.right && other.right > box.left && other.top < box.bottom && other.bottom > box.top;
      })
      .map((element) => element.textContent.trim());
  });
  assert.deepEqual(covered, []);
  await page.evaluate(() => globalThis.quietMadeUp(false));
});
