// Programs: upload, start, hold, leaving, messages.
import assert from 'node:assert/strict';
import { at, number, press, ready, rests, square, takeControl, text, until, upload, view } from '../operator.mjs';
import { anywhere, onMachine, onMadeUp } from '../case.mjs';

onMadeUp('a scroll of the program that comes after its view has gone gives no error', async (page) => {
  await ready(page);
  await view(page, 'program');
  const list = await page.locator(at('program-list')).elementHandle();
  await view(page, 'jog');
  await until('the list to go', () => list.evaluate((element) => !element.isConnected));
  await list.evaluate((element) => element.dispatchEvent(new Event('scroll')));
});

onMadeUp('Start there starts the line that its dialog shows', async (page) => {
  await ready(page);
  await page.evaluate(() => (globalThis.changeMadeUp({ mode: 'auto' }), globalThis.loadMadeUpText('data:text/plain,G0 X1%0AG0 X2%0AG0 X3%0AM2%0A')));
  await page.route('**/restart/**', (route) => route.fulfill({ json: { line: 2, modes: 'G21', position: [0, 0, 0], steps: [], problem: '' } }));
  const choose = (line) => page.evaluate(async (line) => ((await import('/src/lib/selection.svelte.ts')).selection.line = line), line);
  await view(page, 'program');
  await choose(2);
  await page.locator(`${at('run-from')}:enabled`).click();
  await page.locator(`${at('run-from-ok')}:enabled`).waitFor();
  // A search in the path that ends late, and a program that was loaded.
  for (const line of [3, 0]) {
    await choose(line);
    await page.waitForTimeout(50);
    assert.match(await page.locator('#from-title').innerText(), /2/);
  }
  await page.locator(at('run-from-ok')).click();
  const started = () => page.evaluate(() => globalThis.madeUpOrders.filter(({ name }) => name === 'start').map(({ line }) => line).join());
  await until('started', async () => (await started()) === '2' || started());
});

onMadeUp('the remaining time is that of where the run is, at the present override, and of no other program', async (page) => {
  const found = await page.evaluate(async () => {
    const { ChunkBuilder } = await import('/src/path/chunk-builder.ts');
    const { RunProgress } = await import('/src/path/run-progress.ts');
    const { path } = await import('/src/path/store.svelte.ts');
    // Lines 1 to 4, each 100 mm along X at 10 mm/s: 40 s.
    const builder = new ChunkBuilder(() => {});
    const count = 401;
    const chunk = { position: new Float32Array(3 * count), feed: new Float32Array(count).fill(10), line: new Uint32Array(count), limit: new Uint8Array(count) };
    for (let i = 0; i < count; i += 1) {
      chunk.position[3 * i] = i;
      chunk.line[i] = Math.max(1, Math.ceil(i / 100));
    }
    builder.append(chunk);
    builder.finish();
    const fractions = (...places) => {
      const run = new RunProgress(new Float64Array(builder.profile), builder.lines);
      return places.map(([line, pathDone]) => Math.round(100 * run.timeFraction({ job: 1, line, pathDone })));
    };
    path.complete(new Float64Array(builder.profile), builder.lines);
    return {
      whole: fractions([1, 0], [2, 160], [4, 400]),
      opened: fractions([3, 240]),
      // From line 3, after 70 mm of approach that are counted as part of line 3.
      fromLine: fractions([3, 0], [3, 80], [4, 170], [4, 230]),
      noLine: fractions([0, 100]),
    };
  });
  assert.deepEqual(found, { whole: [0, 40, 100], opened: [60], fromLine: [50, 70, 75, 90], noLine: [25] });
  await ready(page);
  await view(page, 'program');
  // At once: it goes away between two looks.
  const remaining = () => page.evaluate(() => document.querySelector('[data-test="remaining"]')?.innerText.replace(/ .*/, '') ?? null);
  const is = (what, wanted) => until(what, async () => (await remaining()) === wanted || remaining());
  await page.evaluate(() => {
    globalThis.loadMadeUpText('data:text/plain,G1 X100 F600%0AG1 X200%0AG1 X300%0AG1 X400%0A');
    globalThis.changeMadeUp({ activity: 'program', state: 'held', hold: true, job: 7, line: 3, pathDone: 0 });
  });
  // The plan says 45.2 s.
  await is('half of it', '0:23');
  await page.evaluate(() => globalThis.changeMadeUp({ override: 0.5 }));
  await is('at 50 %', '0:45');
  await page.locator('.current').first().waitFor();
  await page.evaluate(() => globalThis.changeMadeUp({ program: 'other.ngc' }));
  await is('another program', null);
  assert.equal(await page.locator('.current').count(), 0, 'a line of another text');
});

anywhere('parts and times of the program are counted', async (page, context) => {
  await ready(page);
  const told = () => text(page, 'run-times');
  if (context.real) {
    await upload(page, 'parts.ngc', square(5, 600));
    await until('checked', async () => (await text(page, 'findings-button')) === 'no errors' || text(page, 'findings-button'), 20_000);
    assert.match(await told(), /^0 parts; running time 0:00/);
  }
  await view(page, 'program');
  await page.locator(at('start')).click();
  await page.locator(`${at('hold')}:enabled`).click();
  await until('held', async () => /of which held 0:0[1-9]/.test(await told()) || told());
  await page.locator(at('resume')).click();
  await until('it runs', async () => /running time 0:0[2-9]/.test(await told()) || told());
  if (!context.real) return void (await page.locator(at('stop')).click());
  await until('its end', async () => /^1 part; /.test(await told()) || told(), 20_000);
});

onMachine('a tool change asks for the tool, and goes on when it is confirmed', async (page) => {
  await ready(page);
  await upload(page, 'tools.ngc', 'G21 G90 G94\nG1 X1 F1000\nT3 M6\nG1 X2\nM2\n');
  await until('checked', async () => (await text(page, 'findings-button')) === 'no errors' || text(page, 'findings-button'), 20_000);
  await page.locator(at('start')).click();
  await until('asked', async () => /Put tool 3 into the spindle, then press “T3 loaded”/.test(await text(page, 'advice')) || text(page, 'advice'));
  assert.doesNotMatch(await text(page, 'tool'), /T3/, 'not before it is confirmed');
  await page.locator(`${at('loaded')}:enabled`).click();
  await until('done', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 20_000);
  assert.match(await text(page, 'tool'), /T3/);
  // Back, so that the next case finds what it expects.
  await view(page, 'mdi');
  await page.locator(at('mdi-block')).fill('M61 Q0');
  await page.locator(`${at('mdi-run')}:enabled`).click();
  await until('T0', async () => /T0/.test(await text(page, 'tool')) || text(page, 'tool'));
});

onMachine('single step holds at the end of each line', async (page) => {
  await ready(page);
  await upload(page, 'steps.ngc', 'G21 G90 G94\nG53 G1 X0 F3000\nG53 G1 X4\nG53 G1 X9\nM2\n');
  await until('checked', async () => (await text(page, 'findings-button')) === 'no errors' || text(page, 'findings-button'), 20_000);
  await page.locator('button:has-text("Machine")').first().click();
  await page.locator(at('single-step')).click();
  await page.locator(`${at('single-step')}[aria-pressed="true"]`).waitFor();
  const x = () => number(page, 'large-X');
  try {
    await page.locator(`${at('step')}:enabled`).click();
    // Every step ends where a line ends, and none goes on by itself.
    const seen = new Set();
    for (let i = 0; i < 12 && !seen.has(9); i += 1) {
      await until('held', async () => /Held|Ready|Program stop/.test(await text(page, 'state')) || text(page, 'state'));
      await rests(page, 'X');
      seen.add(await x());
      if ((await text(page, 'state')) !== 'Ready') await page.locator(`${at('step')}:enabled`).click();
      await page.waitForTimeout(150);
    }
    for (const place of seen) assert.ok([0, 4, 9].includes(place), `it held at ${place}`);
    assert.ok(seen.has(4), [...seen].join(' '));
  } finally {
    if (!(await page.locator(at('stop')).isDisabled())) await page.locator(at('stop')).click();
    await until('ended', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
    if ((await page.locator(at('single-step')).getAttribute('aria-pressed')) === 'true') await page.locator(at('single-step')).click();
    await page.locator(`${at('single-step')}[aria-pressed="false"]`).waitFor();
  }
});

onMadeUp('a program of 50 MB can be scrolled, and the page holds the lines in sight only', async (page, context) => {
  await page.evaluate(() => {
    globalThis.longTasks = [];
    new PerformanceObserver((list) => globalThis.longTasks.push(...list.getEntries().map((entry) => entry.duration))).observe({ type: 'longtask' });
  });
  const lines = await context.program(page, 50_000_000);
  await view(page, 'program');
  const list = page.locator(at('program-list'));
  await until('the whole text', async () => (await list.evaluate((element) => element.scrollHeight)) > 5_000_000, 60_000);
  // A task's duration has in it what the host gave to others meanwhile: it is a figure, of which the best of three passes counts.
  const longest = [];
  while (longest.length < 3 && !longest.some((ms) => ms <= 50)) {
    if (longest.length > 0) {
      await page.evaluate(() => (globalThis.longTasks.length = 0));
      await context.program(page, 50_000_000);
    }
    for (let i = 0; i <= 10; i += 1) {
      await list.evaluate((element, ratio) => (element.scrollTop = ratio * (element.scrollHeight - element.clientHeight)), i / 10);
      await page.waitForTimeout(100);
    }
    await until('the whole text again', async () => (await list.evaluate((element) => element.scrollHeight)) > 5_000_000, 60_000);
    longest.push(await page.evaluate(() => Math.max(0, ...globalThis.longTasks)));
  }
  const held = await page.locator('[data-line]').count();
  assert.ok(held < 500, `${held} of ${lines} lines`);
  await list.evaluate((element) => (element.scrollTop = element.scrollHeight));
  await until('the last line', async () => (await page.locator(`[data-line="${lines}"] .code`).count()) === 1 && (await page.locator(`[data-line="${lines}"] .code`).innerText()) !== '');
  await list.focus();
  await page.keyboard.press('Home');
  await until('the first line', async () => (await page.locator('[data-line="1"] .code').count()) === 1);
  console.log(`        longest tasks ${longest.map((ms) => (ms === 0 ? 'below 50' : ms.toFixed(0))).join(', ')} ms`);
  // Only where somebody has kept the host free for it.
  if (process.env.EVOLVENT_TIMINGS) assert.ok(Math.min(...longest) <= 50, `tasks of ${longest.join(', ')} ms`);
});

onMachine('a program is uploaded, held, resumed and stopped', async (page) => {
  await ready(page);
  await upload(page, 'square.ngc', square(100, 600));
  await until('checked and planned', async () => /planned 0:\d\d/.test(await page.locator('.top').innerText()) || page.locator('.top').innerText(), 30_000);
  await page.locator(at('start')).click();
  await until('runs', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
  await until('a current line', async () => (await page.locator('.line.current').count()) === 1);
  await until('a remaining time', async () => /\d:\d\d left/.test(await text(page, 'remaining')), 20_000);
  await page.locator(at('hold')).click();
  await until('held', async () => (await text(page, 'state')) === 'Held' || text(page, 'state'));
  assert.match(await text(page, 'advice'), /Resume/);
  const held = await number(page, 'large-X');
  await page.waitForTimeout(200);
  assert.equal(await number(page, 'large-X'), held);
  await page.locator(at('resume')).click();
  await until('goes on', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
  await page.locator(at('stop')).click();
  await until('stopped', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
});

/** Presses Return, and Hold as soon as it can be pressed: within the page, since a browser that is slow to answer could miss the way back. */
async function returnAndHold(page) {
  await page.locator(`${at('return')}:enabled`).waitFor();
  await page.evaluate(
    async ([back, hold]) => {
      document.querySelector(back).click();
      while (document.querySelector(hold).disabled) await new Promise((resolve) => setTimeout(resolve, 5));
      document.querySelector(hold).click();
    },
    [at('return'), at('hold')],
  );
}

anywhere('a held program is left by a jog, resumed only after the way back, and retraced', async (page, context) => {
  await ready(page);
  if (context.real) {
    await upload(page, 'leave.ngc', `G21 G90 G94 G64 P0.01\nG1 X0 Y0 F3000\n${square(60, 900)}`);
    await until('checked', async () => (await text(page, 'findings-button')) === 'no errors' || text(page, 'findings-button'), 20_000);
  }
  await view(page, 'jog');
  const disabled = (name) => page.locator(at(name)).isDisabled();
  for (const name of ['return', 'retrace']) assert.equal(await disabled(name), true, `${name} without a program`);
  await page.locator(at('start')).click();
  await until('runs', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
  // Into the square's second side, so that there are starts of blocks before it.
  if (context.real) await until('line 5', async () => (await text(page, 'advice')) === 'Line 5 is running.' || text(page, 'advice'), 30_000);
  await page.waitForTimeout(500);
  assert.equal(await disabled('jog-Z-plus'), true, 'no jog while it moves');
  await page.locator(at('hold')).click();
  await until('held', async () => (await text(page, 'state')) === 'Held' || text(page, 'state'));
  await rests(page, 'X');
  const held = await Promise.all(['X', 'Y', 'Z'].map((letter) => number(page, `large-${letter}`)));
  const isThere = async () => {
    const now = await Promise.all(['X', 'Y', 'Z'].map((letter) => number(page, `large-${letter}`)));
    return now.every((value, axis) => value === held[axis]) || [now, held];
  };
  assert.equal(await disabled('resume'), false);
  // A jog by its distance, with the keyboard: arrows are locked, the buttons are not.
  await page.locator(at('increment-10')).click();
  await page.locator(at('jog-Z-plus')).focus();
  await page.keyboard.press('Enter');
  await until('Z 10 higher', async () => Math.abs((await number(page, 'large-Z')) - held[2] - 10) < 0.0015 || number(page, 'large-Z'));
  await until('a way back', async () => (await disabled('return')) === false);
  for (const name of ['resume', 'step', 'retrace', 'home-X']) assert.equal(await disabled(name), true, `${name} while away`);
  assert.match(await text(page, 'advice'), /Z moved away from the held program. Press “Return”/);
  assert.match(await text(page, 'jog-note'), /away from the program; the way back/);
  // A jog with the finger on it, which ends where it is lifted.
  await page.locator(at('increment-0')).click();
  await press(page, 'jog-X-minus');
  await until('X moves', async () => (await number(page, 'large-X')) < held[0] - 1 || number(page, 'large-X'), 20_000);
  await page.mouse.up();
  await rests(page, 'X');
  if (context.real) {
    // So far that Hold on the way back comes before its end. A host that pauses ends a jog that needs a finger.
    await page.locator(at('increment-10')).click();
    for (let i = 0; i < 5; i += 1) {
      const before = await number(page, 'large-X');
      await page.locator(at('jog-X-minus')).click();
      await until('X 10 lower', async () => Math.abs((await number(page, 'large-X')) - before + 10) < 0.0015 || number(page, 'large-X'));
    }
  }
  await until('X and Z', async () => /X Z moved away/.test(await text(page, 'advice')) || text(page, 'advice'));
  assert.equal(await text(page, 'state'), 'Held');
  if (context.real) {
    // The core refuses it as well, whatever a page sends.
    await page.locator(at('resume')).evaluate((button) => {
      button.disabled = false;
      button.click();
    });
    await until('rejection 932', async () => /Rejected \(932\)/.test(await page.locator(at('advice')).innerText()) || page.locator(at('advice')).innerText());
    // The way back can be held as well.
    await returnAndHold(page);
    await rests(page, 'X');
    await rests(page, 'Z');
  }
  await until('return again', async () => (await disabled('return')) === false || text(page, 'advice'));
  await page.locator(at('return')).click();
  await until('back', async () => (await isThere()) === true && (await disabled('resume')) === false || text(page, 'advice'), 20_000);
  assert.deepEqual(await isThere(), true);
  // By the number of blocks that is entered, of those that there are.
  const blocks = page.locator(at('retrace-blocks'));
  for (const wrong of ['0', '1.5', '99999']) {
    await blocks.fill(wrong);
    assert.equal(await disabled('retrace'), true, wrong);
  }
  await blocks.fill('2');
  await until('two are possible', async () => !(await disabled('retrace')));
  await page.locator(at('retrace')).click();
  await until('backwards', async () => (await isThere()) !== true && (await disabled('return')) === false, 20_000);
  assert.match(await text(page, 'advice'), /back along the path/);
  assert.equal(await disabled('resume'), true);
  await page.locator(at('return')).click();
  await until('forwards again', async () => (await isThere()) === true && (await disabled('resume')) === false || text(page, 'advice'), 20_000);
  await page.locator(at('resume')).click();
  await until('goes on', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
  await page.locator(at('stop')).click();
  await until('stopped', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'));
});

onMachine('a program that is uploaded again under its name shows its new text and path', async (page) => {
  await takeControl(page);
  const shown = async (wanted) => until(wanted, async () => (await page.locator('[data-line="2"] .code').innerText()) === wanted || page.locator('[data-line="2"] .code').innerText());
  // Both have the same size.
  for (const side of [10, 20]) {
    await upload(page, 'again.ngc', square(side, 1000));
    await shown(`G1 X${side} Y0 F1000`);
    await until('planned', async () => (await page.locator(at('planned')).count()) === 1, 20_000);
  }
});

onMachine('a program that another client has loaded is shown before it can be started', async (page, context) => {
  await ready(page);
  await upload(page, 'mine.ngc', square(30, 600));
  await until('planned', async () => (await page.locator(at('planned')).count()) === 1, 20_000);
  await page.locator(`${at('start')}:enabled`).waitFor();
  const line = async (number) => (await page.locator(`[data-line="${number}"] .code`).innerText().catch(() => '')).trim();
  /** Whenever Start or Step is on, what is shown is what the core has loaded. */
  const look = () =>
    page.evaluate(() => ({
      advice: document.querySelector('[data-test="advice"]').innerText,
      name: document.querySelector('.top .name')?.innerText ?? '',
      isOn: ['start', 'step', 'run-from'].filter((name) => !document.querySelector(`[data-test="${name}"]`).disabled),
    }));
  const other = context.write('other.ngc', 'G21 G90 G94\n(of somebody else)\nG1 X7 F600\nM2\n');
  await page.locator('[data-line="3"]').click();
  await page.locator(at('run-from')).click();
  const told = page.locator(at('run-from-way'));
  await until('the way', async () => (await told.locator('ol').count()) === 1 || told.innerText());
  const loading = context.ctl('load', other);
  // The dialog of what was shown starts nothing any more.
  await until('the dialog is off', async () => (await page.locator(at('run-from-ok')).isDisabled()) && /mine\.ngc would no longer be started/.test(await told.innerText()) || told.innerText());
  await page.keyboard.press('Escape');
  await until('the loaded program is shown', async () => {
    const seen = await look();
    const isOther = /runs other\.ngc/.test(seen.advice);
    if (seen.isOn.length > 0 && isOther) assert.equal(seen.name, 'other.ngc', 'Start is on beside another text');
    return (isOther && seen.name === 'other.ngc' && (await line(2)) === '(of somebody else)') || seen;
  });
  await loading;
  await until('planned', async () => (await page.locator(at('planned')).count()) === 1, 20_000);
  assert.equal(await text(page, 'findings-button'), 'no errors');
  // Its text changes on the disk: what is shown follows.
  context.write('other.ngc', 'G21 G90 G94\n(another text)\nG1 X8 F600\nM2\n');
  await until('the new text', async () => (await line(2)) === '(another text)' || line(2));
  await page.locator(`${at('start')}:enabled`).click();
  await until('it has run', async () => /1 part/.test(await text(page, 'run-times')) || text(page, 'run-times'), 30_000);
  await until('ready', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 20_000);
  // A file that is gone cannot be shown, and what cannot be shown is not started.
  const gone = context.write('gone.ngc', 'G21 G90\nG1 X1 F600\nM2\n');
  await context.ctl('load', gone);
  context.remove('gone.ngc');
  await until('why', async () => {
    const seen = await look();
    return (/gone\.ngc is loaded and cannot be shown: “Start” is off/.test(seen.advice) && seen.isOn.length === 0) || seen;
  });
  // An upload is what is loaded again.
  await upload(page, 'mine.ngc', square(20, 3000));
  await page.locator(`${at('start')}:enabled`).waitFor();
  assert.match(await text(page, 'advice'), /runs mine\.ngc/);
}, 'ctl');

anywhere('a message of a program is shown in each of its runs', async (page, context) => {
  await ready(page);
  if (!context.real) {
    // What the status says counts, whatever it said in the job before: pages get not every status.
    for (const job of [1, 2]) {
      await page.evaluate((job) => globalThis.changeMadeUp({ activity: 'program', state: 'program_stop', hold: true, job, message: 'clamp the part' }), job);
      await until(`the message of job ${job}`, async () => (await text(page, 'advice')) === 'clamp the part' || text(page, 'advice'));
      await page.evaluate(() => globalThis.changeMadeUp({ activity: 'none', state: 'idle', hold: false }));
      await until('ready', async () => (await text(page, 'state')) === 'Ready');
    }
    await view(page, 'events');
    assert.equal(await page.locator(`${at('events')} li.message`, { hasText: 'clamp the part' }).count(), 2);
    return;
  }
  await upload(page, 'message.ngc', 'G21 G90\n(MSG, clamp the part)\nM0\nG4 P0.2\nM2\n');
  await until('checked', async () => (await text(page, 'findings-button')) === 'no errors' || text(page, 'findings-button'), 20_000);
  for (const run of ['first', 'second']) {
    await page.locator(`${at('start')}:enabled`).click();
    await until(`the ${run} run waits`, async () => (await text(page, 'state')) === 'Program stop' || text(page, 'state'));
    await until(`the message of the ${run} run`, async () => (await text(page, 'advice')) === 'clamp the part' || text(page, 'advice'));
    assert.equal(await text(page, 'message'), 'clamp the part', run);
    await page.locator(`${at('resume')}:enabled`).click();
    await until(`the ${run} run is over`, async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 20_000);
  }
  await view(page, 'events');
  const told = page.locator(`${at('events')} li.message`, { hasText: 'clamp the part' });
  await until('both are listed', async () => (await told.count()) >= 2 || told.count());
});

onMachine('errors of a program have their place and a help', async (page) => {
  await takeControl(page);
  await upload(page, 'wrong.ngc', 'G21 G90\nG1 X10 F500\nG1 X9999\nM2\n');
  await until('one error', async () => /^1 error/.test(await text(page, 'findings-button')) || text(page, 'findings-button'), 20_000);
  assert.match(await text(page, 'advice'), /has 1 error|Home|power|E-stop/);
  await page.locator(at('findings-button')).click();
  assert.match(await text(page, 'findings'), /line 3[\s\S]*Help:/);
  await page.locator(`${at('findings')} button`).first().click();
  await page.locator('[data-line="3"][aria-selected="true"]').waitFor();
});

onMachine('starting at a line waits with the way there, which is gone on resume', async (page) => {
  await ready(page);
  // The case of touching off has moved the work's zero.
  const places = {};
  for (const system of ['Machine', 'Work']) {
    await page.locator(`button:has-text("${system}")`).first().click();
    places[system] = [await number(page, 'large-X'), await number(page, 'large-Y')];
  }
  const [x, y] = [0, 1].map((axis) => places.Machine[axis] - places.Work[axis]);
  await upload(page, 'from.ngc', square(20, 3000));
  await until('checked', async () => (await text(page, 'findings-button')) === 'no errors' || text(page, 'findings-button'), 20_000);
  await page.locator('[data-line="5"]').click();
  await page.locator(at('run-from')).click();
  // What is in force there and the way, before anything is started: line 4 ended at (0, 20).
  const told = page.locator(at('run-from-way'));
  await until('the way', async () => /Z/.test(await told.locator('ol').innerText().catch(() => '')) || told.innerText());
  const text_of_way = await told.innerText();
  assert.match(text_of_way, /F3000 [\s\S]*G1 /);
  assert.ok(text_of_way.includes(`X${x.toFixed(3)} Y${(y + 20).toFixed(3)}`), text_of_way);
  assert.ok((await told.locator('li').count()) >= 3, await told.innerText());
  assert.equal(await text(page, 'state'), 'Ready', 'nothing has begun');
  await page.locator(at('run-from-ok')).click();
  await until('waits', async () => (await text(page, 'state')) === 'Program stop' || text(page, 'state'));
  console.log(`        ${await text(page, 'advice')}`);
  await page.locator(at('resume')).click();
  await until('done', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 30_000);
});

onMachine('dropping a file uploads it, and switches of the program take effect', async (page) => {
  await takeControl(page);
  await view(page, 'program');
  await page.evaluate((body) => {
    const data = new DataTransfer();
    data.items.add(new File([body], 'dropped.ngc'));
    document.querySelector('.program').dispatchEvent(new DragEvent('drop', { dataTransfer: data, bubbles: true, cancelable: true }));
  }, square(10, 1000));
  await until('loaded', async () => /dropped\.ngc/.test(await page.locator('.top').innerText()) || page.locator('.top').innerText());
  for (const name of ['single-step', 'optional-stop', 'block-delete']) {
    const before = await page.locator(at(name)).getAttribute('aria-pressed');
    await page.locator(at(name)).click();
    await until(name, async () => (await page.locator(at(name)).getAttribute('aria-pressed')) !== before);
    await page.locator(at(name)).click();
    await until(`${name} back`, async () => (await page.locator(at(name)).getAttribute('aria-pressed')) === before);
  }
});

onMadeUp('a tool is confirmed for the tool that was asked for, and by a press of its own', async (page) => {
  await ready(page);
  const change = (to) => page.evaluate((changes) => globalThis.changeMadeUp(changes), to);
  const resumes = () => page.evaluate(() => globalThis.madeUpCommands.filter((name) => name === 'resume').length);
  const wait = (tool) => change({ activity: 'program', state: 'program_stop', toolChange: 'operator', toolWanted: tool });
  await wait(7);
  await page.locator(`${at('loaded')}:enabled`).waitFor();
  assert.match(await text(page, 'loaded'), /T7 loaded/);
  assert.match(await text(page, 'advice'), /Put tool 7 into the spindle, then press “T7 loaded”/);
  assert.equal(await page.locator(at('resume')).count(), 0);
  await page.locator(at('loaded')).click();
  await until('it goes on', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
  assert.equal(await resumes(), 1);
  // Meanwhile the machine waits for another tool: the newest status counts, drawn or not.
  await wait(7);
  await page.locator(`${at('loaded')}:enabled`).waitFor();
  await page.evaluate(async (name) => {
    const { session } = await import('/src/lib/session.svelte.ts');
    globalThis.tellMadeUp({ kind: 'status', status: { ...session.status, toolWanted: 8 } });
    document.querySelector(name).click();
  }, at('loaded'));
  assert.match(await text(page, 'rejection'), /waits for tool 8 now, not for tool 7/);
  assert.equal(await resumes(), 1);
  // A second press on Resume must not confirm the tool of the change that it leads to.
  await change({ toolChange: 'none', state: 'program_stop' });
  await page.locator(`${at('resume')}:enabled`).waitFor();
  const box = await page.locator(at('resume')).boundingBox();
  await wait(9);
  await page.locator(at('loaded')).waitFor();
  await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
  await page.waitForTimeout(100);
  assert.equal(await resumes(), 1);
  await wait(0);
  await until('an empty spindle', async () => /No tool/.test(await text(page, 'loaded')) || text(page, 'loaded'));
});
