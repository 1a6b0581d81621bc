// The scope.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { at, number, press, ready, until, view } from '../operator.mjs';
import { anywhere, onMachine, onMadeUp } from '../case.mjs';

onMadeUp('an envelope keeps every peak, and few samples whole', async (page) => {
  const found = await page.evaluate(async () => {
    const { envelope, firstAt } = await import('/src/scope/envelope.ts');
    const size = 1000;
    const [time, values] = [new Float64Array(size), new Float32Array(size)];
    // More samples than the ring holds: those of 500 to 1499 are left, each at its number modulo the size.
    for (let i = 0; i < 1500; i += 1) [time[i % size], values[i % size]] = [i / 1000, i === 777 ? 50 : i === 1203 ? -60 : Math.sin(i / 40)];
    const all = { begin: 500, end: 1500 };
    const [t, v] = envelope(time, [values], all, 100, 1.499);
    const few = envelope(time, [values], { begin: 1490, end: 1500 }, 100, 0);
    const none = envelope(time, [new Float32Array(size).fill(NaN)], all, 100, 0);
    return {
      points: v.length,
      times: [...t],
      values: [...v],
      peak: t[v.indexOf(50)],
      few: [...few[0]],
      none: none[1].every(Number.isNaN),
      first: [firstAt(time, all, 1.2), firstAt(time, all, 0), firstAt(time, all, 9)],
    };
  });
  assert.equal(found.points, 200);
  assert.ok(found.values.includes(50) && found.values.includes(-60), 'both peaks, each of one sample');
  assert.ok(Math.abs(found.peak - (0.777 - 1.499)) < 0.011, `${found.peak}`);
  assert.deepEqual(found.times, [...found.times].sort((a, b) => a - b));
  assert.equal(found.few.length, 10);
  assert.equal(found.few[0], 1.49);
  assert.equal(found.none, true);
  assert.deepEqual(found.first, [1200, 500, 1500]);
});

onMadeUp('a scope that draws while its plot is still that of another quantity gives no error', async (page) => {
  await ready(page);
  await view(page, 'scope');
  // A busy page: the plot of the new quantity comes when the timer has drawn several times.
  await page.evaluate(() => (window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 200)));
  const quantity = page.locator(at('scope-quantity'));
  const names = await quantity.locator('option').evaluateAll((list) => list.map((option) => option.value));
  assert.ok(names.length >= 13, `${names}`);
  const legend = () => page.locator(`${at('scope')} .u-legend .u-series`).count();
  // One line after three and three after one, and each quantity after each of another number of lines.
  for (const name of [...names, ...names.toReversed(), 'velocity', 'feed', 'velocity']) {
    await quantity.selectOption(name);
    await page.waitForTimeout(260);
  }
  await until('time and three axes', async () => (await legend()) === 4 || legend());
});

onMadeUp('lines break where samples were lost, in the scope and in the trail', async (page) => {
  const found = await page.evaluate(async () => {
    const { envelope, breaksIn } = await import('/src/scope/envelope.ts');
    const { History } = await import('/src/lib/session.svelte.ts');
    const { Trail } = await import('/src/path/trail.ts');
    const { View } = await import('/src/path/view.ts');
    const history = new History(3, 4000);
    const push = (time) => history.push({ time, line: 1, rapid: false, feed: 0, position: [100 * time, 0, 0], velocity: [1, 0, 0], acceleration: [0, 0, 0], error: null, load: null }, null);
    // A frame of 16 setpoints is lost, then the machine is another one, of 4 ms.
    for (let i = 0; i < 2000; i += 1) if (i < 1000 || i >= 1016) push(i / 1000);
    const slower = history.count;
    for (let i = 1; i < 100; i += 1) push(1.999 + i / 250);
    const gaps = Array.from({ length: history.count }, (_, i) => i).filter((i) => history.gap[i] === 1);
    const span = { begin: 0, end: slower };
    const few = envelope(history.time, [history.velocity[0]], { begin: 990, end: 1010 }, 100, 0, history.gap);
    const many = envelope(history.time, [history.velocity[0]], span, 100, 0, history.gap);
    const nan = ([times, values]) => [...values.keys()].filter((i) => Number.isNaN(values[i])).map((i) => times[i]);
    const lines = [];
    let at = null;
    const context = { clearRect() {}, beginPath() {}, stroke() {}, moveTo: (x, y) => (at = [x, y]), lineTo: (x, y) => (at && lines.push(Math.hypot(x - at[0], y - at[1])), (at = [x, y])) };
    const view = new View();
    Object.assign(view, { width: 800, height: 600, scale: 3 });
    const trail = new Trail(view);
    trail.attach({ width: 800, height: 600, getContext: () => context });
    const whole = { ...history, gap: history.gap, position: history.position, count: slower, capacity: history.capacity };
    trail.draw(whole, [0, 1, 2], 'black', 0);
    return {
      gaps, slower, copied: history.copy(2000).gap[1000], of: breaksIn(history.gap, span), few: [few[0].length, nan(few)], many: [many[0].length, nan(many)],
      sorted: many[0].every((time, i) => i === 0 || time > many[0][i - 1]), trail: [lines.length, Math.max(...lines)],
    };
  });
  // 4 ms after 1 ms is a gap until a second one follows.
  assert.deepEqual(found.gaps, [1000, found.slower]);
  assert.equal(found.copied, 1);
  assert.equal(found.of, 1);
  assert.equal(found.few[0], 21);
  assert.ok(found.few[1].length === 1 && Math.abs(found.few[1][0] - 1.0075) < 1e-9, `${found.few}`);
  assert.ok(found.many[1].length === 1 && Math.abs(found.many[1][0] - 1.0075) < 1e-9, `${found.many}`);
  assert.ok(found.sorted);
  // 0.3 px in a setpoint; 4.8 px were never seen.
  assert.ok(found.trail[0] > 500 && found.trail[1] < 1.5, `${found.trail}`);
});

onMadeUp('numbers of the scope have as many digits as tell them apart', async (page) => {
  const found = await page.evaluate(async () => {
    const { tickTexts, valueText } = await import('/src/scope/numbers.ts');
    const marks = (step) => tickTexts([-2, -1, 0, 1, 2].map((n) => n * step), step);
    return [marks(0.0005), marks(0.00025), marks(50), marks(2.5), marks(1e-9), tickTexts([-1e-17, 0.1 + 0.2], 0.1), [0.00012345678, -0.1, 12345.678, null, NaN].map(valueText)];
  });
  assert.deepEqual(found, [
    ['-0.0010', '-0.0005', '0', '0.0005', '0.0010'], ['-0.00050', '-0.00025', '0', '0.00025', '0.00050'], ['-100', '-50', '0', '50', '100'],
    ['-5.0', '-2.5', '0', '2.5', '5.0'], ['-2e-9', '-1e-9', '0', '1e-9', '2e-9'], ['0', '0.3'], ['0.000123457', '-0.1', '12345.7', '–', '–'],
  ]);
});

onMadeUp('the scope keeps what it shows: a picture that stands, its trigger and its settings', async (page) => {
  await ready(page);
  const rings = await page.evaluate(async () => {
    const { History, session } = await import('/src/lib/session.svelte.ts');
    const status = { latenessNs: 0, workOffset: [0], toolOffset: [0] };
    const ring = new History(1, 10);
    for (let i = 0; i < 25; i += 1) ring.push({ time: i, line: i, rapid: false, feed: i, position: [i], velocity: [-i], acceleration: [0], error: null, load: i }, status);
    const copy = ring.copy(5, 23);
    // What is copied stays, whatever the ring does.
    for (let i = 25; i < 60; i += 1) ring.push({ time: i, line: i, rapid: false, feed: i, position: [i], velocity: [-i], acceleration: [0], error: null, load: i }, status);
    const at = (list) => Array.from({ length: 5 }, (_, i) => list[(18 + i) % 5]);
    // 4 kHz: 60 s of it.
    const samples = Array.from({ length: 8 }, (_, i) => ({ time: 1e6 + i * 0.00025, line: 0, rapid: false, feed: 0, position: [0, 0, 0], velocity: [0, 0, 0], acceleration: [0, 0, 0], error: null, load: null }));
    globalThis.tellMadeUp({ kind: 'samples', samples });
    return { count: copy.count, feed: at(copy.feed), velocity: at(copy.velocity[0]), capacity: session.history.capacity };
  });
  assert.deepEqual({ ...rings, capacity: Math.round(rings.capacity / 1000) }, { count: 23, feed: [18, 19, 20, 21, 22], velocity: [-18, -19, -20, -21, -22], capacity: 240 });
  await page.reload();
  await ready(page);
  await view(page, 'scope');
  await page.locator(at('scope-quantity')).selectOption('position');
  await page.locator(at('scope-seconds')).selectOption('1');
  await page.locator(at('scope-level')).fill('5');
  await page.locator(at('scope-trigger')).selectOption('rising');
  // The trigger comes while another view is shown.
  await view(page, 'jog');
  await page.locator(at('increment-10')).click();
  await page.locator(at('jog-X-plus')).click();
  await page.waitForTimeout(1200);
  await view(page, 'scope');
  assert.deepEqual([await page.locator(at('scope-quantity')).inputValue(), await page.locator(at('scope-seconds')).inputValue()], ['position', '1']);
  await page.locator(`${at('scope-pause')}[aria-pressed="true"]`).waitFor({ timeout: 3000 });
  const shown = async () => page.evaluate(async () => {
    const { scope } = await import('/src/scope/scope.svelte.ts');
    const { paused } = scope;
    const { begin, end } = scope.span(paused);
    const list = paused.position[0];
    return [end - begin, list[begin % paused.capacity] < 5, list[(end - 1) % paused.capacity] > 5];
  });
  const before = await shown();
  assert.ok(before[0] > 20 && before[1] && before[2], JSON.stringify(before));
  // Other quantities of the same time are there, too.
  await page.locator(at('scope-quantity')).selectOption('feed');
  await page.waitForTimeout(200);
  assert.deepEqual((await shown())[0], before[0]);
});

onMadeUp('the scope shows what drives report, jerk, spindles, inputs and outputs, and a picture that stands keeps them at full rate', async (page) => {
  await ready(page);
  // Quiet: the only samples are these, of a setpoint each millisecond; one is missing.
  await page.evaluate(async () => {
    globalThis.quietMadeUp(true);
    const { session, History } = await import('/src/lib/session.svelte.ts');
    session.history = new History(3, 4000, 1, 6);
    const samples = [];
    for (let i = 0; i < 3000; i += 1) {
      if (i === 2500) continue;
      samples.push({
        time: 1000 + i / 1000, line: 1, rapid: false, feed: 0, position: [0, 0, 0], velocity: [10, 0, 0], acceleration: [2 * i, 0, 0], error: null, load: null,
        actualVelocity: [9.5, 0, 0], actualPosition: [0.25, -0.5, 0], torque: [0.75, 0, -0.5], phaseError: -2.5, spindles: [800, 790 + (i % 10), (i * 4.8) % 360], signals: [i % 1000 < 500 ? 1 : 0, 6.25, NaN, 1, 0, 2.5],
      });
    }
    globalThis.tellMadeUp({ kind: 'samples', samples });
  });
  await view(page, 'scope');
  const quantity = page.locator(at('scope-quantity'));
  await page.locator(at('scope-seconds')).selectOption('5');
  await page.locator(at('scope-pause')).click();
  await until('every sample', async () => Number(await page.locator(at('scope')).getAttribute('data-points')) === 2999, 5000);
  // A picture that stands shows another quantity over the same time.
  const drawn = () => page.locator(`${at('scope')} canvas`).evaluate((canvas) => {
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) if (Math.max(data[i], data[i + 1], data[i + 2]) - Math.min(data[i], data[i + 1], data[i + 2]) > 60) count += 1;
    return count;
  });
  const table = async (name) => {
    await quantity.selectOption(name);
    await until(`a picture of ${name}`, async () => (await drawn()) > 100 || drawn(), 3000);
    const [download] = await Promise.all([page.waitForEvent('download'), page.locator(at('scope-export')).click()]);
    const [heading, ...rows] = readFileSync(await download.path(), 'utf8').trim().split('\n');
    assert.equal(rows.length, 2999, name);
    return [heading, rows.map((row) => row.split(',').slice(2).map((text) => (text === '' ? null : Number(text))))];
  };
  const [heading, actual] = await table('actualVelocity');
  assert.equal(heading, 'time_s,line,X_actualVelocity_mm_s,Y_actualVelocity_mm_s,Z_actualVelocity_mm_s');
  assert.deepEqual(actual[7], [9.5, 0, 0]);
  const [places, place] = await table('actualPosition');
  assert.equal(places, 'time_s,line,X_actualPosition_mm,Y_actualPosition_mm,Z_actualPosition_mm');
  assert.deepEqual(place[7], [0.25, -0.5, 0]);
  const [torques, torque] = await table('torque');
  assert.equal(torques, 'time_s,line,X_torque,Y_torque,Z_torque');
  assert.deepEqual(torque[7], [0.75, 0, -0.5]);
  const [phases, phase] = await table('phaseError');
  assert.equal(phases, 'time_s,line,phaseError_us');
  assert.deepEqual(phase[7], [-2.5]);
  const [, jerk] = await table('jerk');
  assert.equal(jerk[0][0], null, 'none before the first');
  assert.ok(Math.abs(jerk[100][0] - 2000) < 2, String(jerk[100][0]));
  assert.equal(jerk[2500][0], null, 'a setpoint is missing');
  const [speeds, speed] = await table('spindleSpeed');
  assert.equal(speeds, 'time_s,line,commanded_S_spindleSpeed_rpm,measured_S_spindleSpeed_rpm');
  assert.deepEqual(speed[3], [800, 793]);
  const [, angle] = await table('spindleAngle');
  assert.ok(Math.abs(angle[10][0] - 48) < 0.01);
  const [analogs, analog] = await table('analog');
  assert.equal(analogs, 'time_s,line,input_air-pressure-bar,input_wheel,output_laser-power');
  assert.deepEqual(analog[5], [6.25, null, 2.5]);
  const [names, digital] = await table('digital');
  assert.equal(names, 'time_s,line,input_door-closed,output_dust-extraction,output_work-light');
  assert.deepEqual([digital[499], digital[500]], [[1, 1, 0], [0, 1, 0]]);
  assert.match(await page.locator(at('scope')).innerText(), /door-closed/);
  // One that is not wanted goes.
  await page.locator(at('scope-line')).filter({ hasText: 'work-light' }).click();
  await until('two lines', async () => (await table('digital'))[0] === 'time_s,line,input_door-closed,output_dust-extraction');
  await quantity.selectOption('velocity');
  assert.equal(await page.locator(at('scope-line')).filter({ hasText: 'X' }).getAttribute('aria-pressed'), 'true', 'the choice of axes is another one');
});

anywhere('the scope stops at its trigger, shows every sample then, and exports them', async (page, context) => {
  await ready(page);
  await view(page, 'scope');
  await page.locator(at('scope-seconds')).selectOption('5');
  const points = async () => Number(await page.locator(at('scope')).getAttribute('data-points'));
  const paused = async () => (await page.locator(at('scope-pause')).getAttribute('aria-pressed')) === 'true';
  await page.waitForTimeout(5000);
  const live = await points();
  const width = await page.locator(at('scope')).evaluate((element) => element.clientWidth);
  // A pixel in which samples were lost has two points more.
  const breaks = Number(await page.locator(at('scope')).getAttribute('data-breaks'));
  assert.ok(live <= 2 * width + 4 + 2 * breaks, `${live} points on ${width} pixels, ${breaks} breaks`);
  // Jogging beside it needs two views.
  await page.setViewportSize({ width: 1920, height: 1080 });
  await page.locator('[data-view="scope"]').nth(1).click();
  await view(page, 'jog');
  await page.locator(at('increment-0')).click();
  await page.locator(at('scope-seconds')).selectOption('5');
  await page.locator(at('scope-level')).fill('10');
  await page.locator(at('scope-trigger')).selectOption('rising');
  await page.waitForTimeout(300);
  assert.equal(await paused(), false, 'nothing has crossed the level');
  await page.locator(`${at('jog-X-plus')}:enabled`).waitFor();
  // A jog whose page has no time for 90 ms ends by itself, and may have ended before a sample was taken of it: then again.
  const start = await number(page, 'large-X');
  await until('a jog that is seen', async () => {
    await press(page, 'jog-X-plus');
    await page.waitForTimeout(400);
    await page.mouse.up();
    return (await number(page, 'large-X')) !== start;
  });
  assert.equal(await paused(), false, 'half of the window is still recorded');
  await until('the trigger', paused, 10_000);
  assert.equal(await page.locator(at('scope-trigger')).inputValue(), 'off');
  const [download] = await Promise.all([page.waitForEvent('download'), page.locator(at('scope-export')).click()]);
  const [heading, ...rows] = readFileSync(await download.path(), 'utf8').trim().split('\n');
  assert.equal(heading, 'time_s,line,X_velocity_mm_s,Y_velocity_mm_s,Z_velocity_mm_s');
  assert.equal(rows.length, await points(), 'the picture that stands has every sample');
  const table = rows.map((row) => row.split(',').map(Number));
  const [from, to] = [table[0][0], table.at(-1)[0]];
  assert.ok(to - from > 2.4 && to - from <= 5.001, `${from} to ${to}`);
  // The level is crossed half of the window before the end.
  const at_ = table.findIndex((row, i) => i > 0 && table[i - 1][2] < 10 && row[2] >= 10);
  assert.ok(at_ > 0, 'X crosses 10 mm/s');
  // The last sample is the first that is half of the window later; a host that gives the page no time makes samples rare.
  const [last, behind] = [to - table[at_][0], table.at(-2)[0] - table[at_][0]];
  assert.ok(last > 2.499 && behind < 2.501, `${behind} and ${last} s`);
  if (context.real) {
    const steps = table.slice(1).map((row, i) => row[0] - table[i][0]).sort((a, b) => a - b);
    const median = steps[steps.length >> 1];
    assert.ok(median < 0.0021, `a sample every ${median} s`);
    assert.ok(rows.length > 2 * width, `${rows.length} samples are more than the envelope had`);
  }
  await page.locator(at('scope-pause')).click();
  await until('live again', async () => !(await paused()));
});

onMachine('the scope has actual position, torque and phase error of the drives', async (page) => {
  await ready(page);
  await view(page, 'jog');
  await page.locator(at('increment-1')).click();
  await page.locator(at('jog-X-plus')).click();
  await view(page, 'scope');
  await page.locator(at('scope-seconds')).selectOption('1');
  const table = async (name) => {
    await page.locator(at('scope-quantity')).selectOption(name);
    await page.waitForTimeout(1500);
    const [download] = await Promise.all([page.waitForEvent('download'), page.locator(at('scope-export')).click()]);
    const [, ...rows] = readFileSync(await download.path(), 'utf8').trim().split('\n');
    return rows.map((row) => row.split(',').slice(2)).at(-1);
  };
  const [commanded, actual] = [await table('position'), await table('actualPosition')];
  for (const axis of [0, 1, 2]) assert.ok(actual[axis] !== '' && Math.abs(Number(actual[axis]) - Number(commanded[axis])) < 0.05, `${commanded}; ${actual}`);
  for (const name of ['torque', 'phaseError']) {
    const row = await table(name);
    assert.ok(row.every((value) => value !== '' && Number.isFinite(Number(value))), `${name}: ${row}`);
  }
});
