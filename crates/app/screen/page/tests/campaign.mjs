// Campaigns that take longer than tests, each on a service of its own: `node tests/campaign.mjs BINARY jogs|soak|large [NUMBER [LOSS...]]`.
//
//   jogs N     N jogs for each way to lose the page that holds them: is the machine at rest in time?
//   soak MIN   20 clients for that many minutes while a program runs: how do server and page grow?
//   large MB   a program of that size: when are its first lines and the first pixels of its path there, is the page ever blocked?
import { mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from 'node:fs';
import { createServer, connect as connectTo } from 'node:net';
import { loadavg, tmpdir } from 'node:os';
import { join } from 'node:path';
import { launchServer } from './browser.mjs';
import { at, ready, takeControl, text, until, view } from './operator.mjs';
import { serve } from './service.mjs';
import { Watcher } from './watcher.mjs';

const [binary, campaign, given, ...chosen] = process.argv.slice(2);
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
/** The clock of setpoints. */
const now = () => Number(process.hrtime.bigint()) * 1e-9;

/** A process and everything that it has started. */
function tree(pid) {
  const parents = new Map();
  for (const entry of readdirSync('/proc')) {
    if (!/^\d+$/.test(entry)) continue;
    try {
      const parent = Number(readFileSync(`/proc/${entry}/stat`, 'utf8').replace(/^.*\) \S /, '').split(' ')[0]);
      parents.set(Number(entry), parent);
    } catch {
      // It has ended meanwhile.
    }
  }
  const found = [pid];
  for (const one of found) for (const [child, parent] of parents) if (parent === one) found.push(child);
  return found;
}

function signal(pids, name) {
  for (const pid of pids) {
    try {
      process.kill(pid, name);
    } catch {
      // It has ended meanwhile.
    }
  }
}

function megabytes(pids) {
  let kib = 0;
  for (const pid of pids) {
    try {
      kib += Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, 'utf8'))?.[1] ?? 0);
    } catch {
      // It has ended meanwhile.
    }
  }
  return kib / 1024;
}

/** The address of a wire between page and server that can be reset, or go dead without a word as a pulled cable does. */
async function wire(url) {
  const port = Number(new URL(url).port);
  const pairs = new Set();
  let dead = false;
  const server = createServer((near) => {
    const far = connectTo(port, '127.0.0.1');
    const pair = [near, far];
    pairs.add(pair);
    const pass = (to) => (data) => {
      if (!dead) to.write(data);
    };
    near.on('data', pass(far));
    far.on('data', pass(near));
    for (const end of pair) {
      end.on('error', () => {});
      end.on('close', () => {
        for (const other of pair) other.destroy();
        pairs.delete(pair);
      });
    }
  });
  // The same port on the other loopback address: the server takes both for itself.
  await new Promise((resolve) => server.listen(port, '::1', resolve));
  const reset = () => {
    for (const pair of pairs) for (const end of pair) end.resetAndDestroy();
  };
  return {
    url: url.replace('127.0.0.1', '[::1]'),
    reset,
    pull: () => (dead = true),
    plug() {
      reset();
      dead = false;
    },
    end() {
      reset();
      server.close();
    },
  };
}

const LOSSES = ['cut', 'pulled', 'killed', 'hidden', 'asleep'];

/** ms after which a jog must brake: the core's 90 ms, and 10 ms and five periods for what is on its way, as in screen_server.rs. */
const allowed = (period) => 100 + 5000 * period;

async function jogs(count) {
  const service = await serve(binary, {});
  const cable = await wire(service.url);
  const watcher = await Watcher.open(service.watch);
  let [chromium, page, session] = [null, null, null];
  const open = async () => {
    if (chromium === null) chromium = await launchServer();
    if (page === null) {
      const context = await chromium.browser.newContext({ viewport: { width: 1024, height: 600 }, locale: 'en' });
      page = await context.newPage();
      session = await context.newCDPSession(page);
    }
    await page.goto(cable.url);
    await page.locator(at('lease')).waitFor();
    await takeControl(page);
    await view(page, 'jog');
    await page.locator(at('increment-0')).click();
  };
  await open();
  await ready(page);
  let direction = 1;
  const trial = async (loss) => {
    if (page === null || loss === 'cut' || loss === 'pulled') await open();
    await takeControl(page);
    await page.locator(`${at(direction > 0 ? 'jog-X-plus' : 'jog-X-minus')}:enabled`).waitFor();
    const box = await page.locator(at(direction > 0 ? 'jog-X-plus' : 'jog-X-minus')).boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    direction = -direction;
    await until('it moves', () => Math.abs(watcher.newest?.velocity ?? 0) > 20, 3000).catch(() => {});
    await sleep(400);
    // Looked for before: it takes a while on a busy host.
    const processes = loss === 'killed' || loss === 'asleep' ? tree(chromium.pid) : [];
    const from = now();
    if (loss === 'cut') cable.reset();
    else if (loss === 'pulled') cable.pull();
    else if (loss === 'killed') signal(processes, 'SIGKILL');
    else if (loss === 'asleep') signal(processes, 'SIGSTOP');
    else {
      // Chromium without a display hides no tab, so the page is told what it hears when one is hidden.
      await session.send('Runtime.evaluate', {
        expression: "Object.defineProperty(document, 'hidden', { value: true, configurable: true }); document.dispatchEvent(new Event('visibilitychange'))",
      });
    }
    // Both for the axes to come to rest and for the watcher to hear of it, on a host that stands still for a while, too.
    await sleep(500);
    await until('samples', () => watcher.newest.time > from + 0.4, 5000).catch(() => {});
    const after = watcher.samples.filter((sample) => sample.time >= from - 0.02);
    // What is due before the loss has nothing to do with it.
    const behind = after.filter((sample) => sample.time >= from);
    const top = Math.abs(after.findLast((sample) => sample.time < from)?.velocity ?? 0);
    const brakes = behind.find((sample) => Math.abs(sample.velocity) < top - 0.01);
    const lastMoving = behind.findLast((sample) => sample.velocity !== 0);
    // Who lags behind loses samples: then nobody knows.
    const gap = Math.max(...after.map((sample, i) => sample.time - (after[i - 1] ?? sample).time));
    const isSeen = gap < 0.02 && watcher.newest.time > from + 0.4 && after[0].time < from;
    const stays = watcher.newest.velocity === 0;
    // Back to a page that can jog again. Nothing may move by itself meanwhile.
    if (loss === 'asleep') signal(processes, 'SIGCONT');
    if (loss === 'pulled') cable.plug();
    const rested = now();
    if (loss === 'killed') [chromium, page] = [null, null];
    else {
      if (loss === 'hidden') await session.send('Runtime.evaluate', { expression: 'delete document.hidden' });
      await page.mouse.up();
    }
    await sleep(loss === 'asleep' ? 500 : 150);
    const crept = watcher.samples.some((sample) => sample.time > rested && sample.velocity !== 0);
    watcher.forget();
    if (!(top > 49.9) || !isSeen) return { outcome: isSeen ? 'not moving' : 'unseen' };
    if (brakes === undefined || lastMoving === undefined) return { outcome: 'never braked' };
    return { outcome: stays && !crept ? 'rest' : 'MOVED AGAIN', brakes: 1000 * (brakes.time - from), rests: 1000 * (lastMoving.time - from) };
  };
  for (const loss of chosen.length > 0 ? chosen : LOSSES) {
    const found = [];
    let [ended, unseen] = [0, 0];
    while (found.length < count && ended + unseen < 3 * count) {
      const result = await trial(loss).catch(async (error) => ({ outcome: `broken: ${error.message}` }));
      // A slow host ends a jog early, because keep-alives come late: it is at rest, but not for the loss.
      if (result.outcome === 'unseen') unseen += 1;
      else if (result.outcome === 'not moving' || result.outcome.startsWith('broken')) {
        ended += 1;
        if (result.outcome.startsWith('broken')) {
          console.log(result.outcome);
          if (page !== null) await page.context().close().catch(() => {});
          page = null;
        }
      } else {
        found.push(result);
        const worst = Math.max(...found.map((one) => one.brakes ?? Infinity));
        if (found.length % 10 === 0) console.log(`  ${loss}: ${found.length}, brakes after at most ${worst.toFixed(1)} ms; ${ended} had ended before, ${unseen} not seen`);
      }
    }
    const limit = allowed(watcher.period);
    const good = found.filter((result) => result.outcome === 'rest' && result.brakes <= limit);
    const sorted = (key) => found.map((result) => result[key]).sort((a, b) => a - b);
    const [brakes, rests] = [sorted('brakes'), sorted('rests')];
    const told = (list) => `median ${list[list.length >> 1]?.toFixed(1)}, maximum ${list.at(-1)?.toFixed(1)} ms`;
    console.log(`${loss}: ${good.length} of ${found.length} in time (${limit.toFixed(0)} ms); brakes after ${told(brakes)}; at rest after ${told(rests)}; ${ended} had ended before, ${unseen} not seen`);
    for (const result of found.filter((result) => !good.includes(result))) console.log(`  ${JSON.stringify(result)}`);
    if (good.length !== found.length || found.length < count) process.exitCode = 1;
  }
  watcher.close();
  if (chromium !== null) await chromium.close();
  cable.end();
  await service.end();
}

/** A program that lasts for `minutes`, in squares; a short one that is started again where it is over. */
const SQUARES = `G21 G90 G17 G54 G94 G64 P0.01\nO1 repeat [100]\nG1 X0 Y0 F6000\nX50\nY50\nX0\nY0 Z1\nG2 X0 Y0 I10 J0\nG1 Z0\nO1 endrepeat\nM2\n`;

/** Growth in MB per hour of a list of [s, MB], by least squares. */
function growth(points) {
  const mean = (index) => points.reduce((sum, point) => sum + point[index], 0) / points.length;
  const [t, m] = [mean(0), mean(1)];
  const over = points.reduce((sum, point) => sum + (point[0] - t) * (point[1] - m), 0);
  return (3600 * over) / points.reduce((sum, point) => sum + (point[0] - t) ** 2, 0);
}

async function soak(minutes) {
  const service = await serve(binary, {});
  const chromium = await launchServer();
  const pages = [];
  for (const shown of ['path', 'scope']) {
    const context = await chromium.browser.newContext({ viewport: { width: 1024, height: 600 }, locale: 'en' });
    const page = await context.newPage();
    await page.goto(shown === 'path' ? service.url : service.watch);
    await page.locator(at('lease')).waitFor();
    const session = await context.newCDPSession(page);
    await session.send('Performance.enable');
    pages.push({ shown, page, session, points: [] });
  }
  const { page } = pages[0];
  await ready(page);
  await view(page, 'program');
  await page.locator(at('program-file')).setInputFiles({ name: 'squares.ngc', mimeType: 'text/plain', buffer: Buffer.from(SQUARES) });
  await until('checked', async () => (await text(page, 'findings-button')) === 'no errors' || text(page, 'findings-button'), 20_000);
  for (const one of pages) await view(one.page, one.shown);
  const clients = [];
  while (clients.length < 20 - pages.length) clients.push(await Watcher.open(service.watch));
  const heap = async ({ session }) => {
    await session.send('HeapProfiler.collectGarbage');
    const { metrics } = await session.send('Performance.getMetrics');
    return metrics.find((metric) => metric.name === 'JSHeapUsedSize').value / (1 << 20);
  };
  const begun = now();
  const [server, browser] = [[], []];
  let runs = 0;
  console.log('s: server MB; browser MB; heaps of the pages MB');
  while (now() - begun < 60 * minutes) {
    if ((await text(page, 'state')) === 'Ready') {
      await takeControl(page);
      await page.locator(at('start')).click();
      runs += 1;
    }
    await sleep(10_000);
    for (const client of clients) client.forget();
    const s = now() - begun;
    server.push([s, megabytes([service.pid])]);
    browser.push([s, megabytes(tree(chromium.pid))]);
    for (const one of pages) one.points.push([s, await heap(one)]);
    const last = (list) => list.at(-1)[1].toFixed(1);
    if (server.length % 6 === 0) console.log(`${s.toFixed(0)}: ${last(server)}; ${last(browser)}; ${pages.map((one) => last(one.points)).join(', ')}`);
  }
  const frames = clients.map((client) => client.frames / (now() - begun));
  console.log(`${clients.length} clients got ${Math.min(...frames).toFixed(1)} to ${Math.max(...frames).toFixed(1)} states/s; ${runs} runs; ${clients.filter((client) => client.isClosed).length} were disconnected`);
  // The page's history fills for a minute, and allocators settle.
  const settled = (list) => list.filter(([s]) => s > Math.min(300, 15 * minutes));
  for (const [what, list] of [['server', server], ['browser with two pages', browser], ...pages.map((one) => [`heap of the ${one.shown} page`, one.points])]) {
    const part = settled(list);
    console.log(`${what}: ${part[0][1].toFixed(1)} to ${part.at(-1)[1].toFixed(1)} MB, ${growth(part).toFixed(2)} MB/h`);
  }
  for (const client of clients) client.close();
  await chromium.close();
  await service.end();
}

/** Lines of a pocket that is milled in circles, each with its number, as a CAM system writes them. */
function largeProgram(bytes) {
  const lines = ['G21 G90 G17 G54 G94 G64 P0.01\n'];
  let size = 0;
  for (let i = 0; size < bytes; i += 1) {
    const [a, r] = [i * 0.05, 20 + 60 * ((i % 20_000) / 20_000)];
    const line = `N${i} G1 X${(r * Math.cos(a)).toFixed(4)} Y${(r * Math.sin(a)).toFixed(4)} Z${(-0.2 * Math.floor(i / 20_000) % 40).toFixed(3)} F6000.0\n`;
    lines.push(line);
    size += line.length;
  }
  lines.push('M2\n');
  return lines;
}

async function large(size) {
  const service = await serve(binary, {});
  const chromium = await launchServer();
  const context = await chromium.browser.newContext({ viewport: { width: 1024, height: 600 }, locale: 'en' });
  const page = await context.newPage();
  await page.goto(service.url);
  await page.locator(at('lease')).waitFor();
  await ready(page);
  const lines = largeProgram(size * 1e6);
  const folder = mkdtempSync(join(tmpdir(), 'evolvent-large-'));
  const file = join(folder, 'large.ngc');
  writeFileSync(file, lines.join(''));
  await page.evaluate(() => {
    globalThis.tasks = [];
    new PerformanceObserver((list) => globalThis.tasks.push(...list.getEntries().map((entry) => [entry.startTime, entry.duration]))).observe({ type: 'longtask' });
    // What a page is for an operator: how long no frame came.
    globalThis.gaps = [];
    let last = performance.now();
    const tick = (time) => {
      globalThis.gaps.push([time, time - last]);
      last = time;
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  });
  const coloured = () =>
    page.locator(at('path-picture')).evaluate((element) => {
      const copy = document.createElement('canvas');
      [copy.width, copy.height] = [element.width >> 2, element.height >> 2];
      const drawing = copy.getContext('2d');
      drawing.drawImage(element, 0, 0, copy.width, copy.height);
      const { data } = drawing.getImageData(0, 0, copy.width, copy.height);
      let count = 0;
      for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 0 && Math.max(data[i], data[i + 1], data[i + 2]) - Math.min(data[i], data[i + 1], data[i + 2]) > 60) count += 1;
      return count;
    });
  await view(page, 'path');
  // The first look compiles what reads pixels: that is none of the page's time.
  await coloured();
  await page.locator('[data-view="program"]').first().click();
  const begun = now();
  await page.locator(at('program-file')).setInputFiles(file);
  await until('loaded', async () => (await page.locator('.top .name').count()) === 1, 60_000);
  const loaded = now();
  await until('its lines', async () => (await page.locator('[data-line="2"] .code').count()) === 1 && (await page.locator('[data-line="2"] .code').innerText()) !== '', 60_000);
  const listed = now();
  await view(page, 'path');
  await until('pixels', async () => (await coloured()) > 5, 120_000);
  const drawn = now();
  console.log(`load ${loadavg()[0].toFixed(1)}; ${size} MB, ${lines.length} lines: uploaded in ${(loaded - begun).toFixed(2)} s; first lines ${(listed - loaded).toFixed(2)} s after it, first pixels of the path ${(drawn - loaded).toFixed(2)} s after it`);
  // While more of it comes, and once it is still: the view is turned all the time.
  const box = await page.locator(at('path')).boundingBox();
  const turn = async (seconds) => {
    const from = await page.evaluate(() => {
      globalThis.tasks.length = globalThis.gaps.length = 0;
      return performance.now();
    });
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    const until_s = now() + seconds;
    for (let i = 0; now() < until_s; i += 1) {
      await page.mouse.move(box.x + box.width / 2 + 150 * Math.sin(i / 15), box.y + box.height / 2 + 60 * Math.sin(i / 23));
      await sleep(8);
    }
    await page.mouse.up();
    return page.evaluate((start) => {
      const span = (performance.now() - start) / 1000;
      const gaps = globalThis.gaps.map(([, gap]) => gap).sort((a, b) => a - b);
      return { fps: gaps.length / span, p99: gaps[Math.floor(gaps.length * 0.99)], longestGap: gaps.at(-1), tasks: globalThis.tasks.map(([, ms]) => Math.round(ms)) };
    }, from);
  };
  for (const what of ['while the path comes', 'later']) {
    const { fps, p99, longestGap, tasks } = await turn(8);
    const note = await page.locator('.holder').innerText();
    console.log(`turned ${what}: ${fps.toFixed(1)} frames/s, 99 % of the gaps below ${p99.toFixed(0)} ms, longest ${longestGap.toFixed(0)} ms; ${tasks.length} tasks above 50 ms${tasks.length ? `, longest ${Math.max(...tasks)} ms` : ''} (${note.replace(/\n/g, ' ').slice(0, 60)})`);
    if (what !== 'later') await sleep(5000);
  }
  await chromium.close();
  await service.end();
  rmSync(folder, { recursive: true });
}

const campaigns = { jogs: () => jogs(Number(given ?? 100)), soak: () => soak(Number(given ?? 30)), large: () => large(Number(given ?? 50)) };
if (campaigns[campaign] === undefined) throw new Error('node tests/campaign.mjs BINARY jogs|soak|large [NUMBER]');
await campaigns[campaign]();
