// The picture of the path.
import assert from 'node:assert/strict';
import { at, ready, square, takeControl, until, upload, view } from '../operator.mjs';
import { anywhere, onMachine, onMadeUp } from '../case.mjs';

/**
 * Pixels of a canvas: how many there are, and how far the leftmost is from the rightmost. Counts those near `colour`, [r, g, b], or
 * without one those that are coloured at all, which texts and grids are not. An element that is not there has none.
 */
const pixels = (canvas, colour = null) =>
  canvas.evaluateAll(([element], wanted) => {
    if (element === undefined) return { count: 0, width: 0 };
    // What WebGL has drawn is read from a copy.
    const copy = document.createElement('canvas');
    [copy.width, copy.height] = [element.width, element.height];
    const context = copy.getContext('2d');
    context.drawImage(element, 0, 0);
    const { data } = context.getImageData(0, 0, copy.width, copy.height);
    let [count, left, right] = [0, Infinity, -Infinity];
    for (let i = 0; i < data.length; i += 4) {
      const [r, g, b] = [data[i], data[i + 1], data[i + 2]];
      const counts =
        wanted === null
          ? data[i + 3] > 0 && Math.max(r, g, b) - Math.min(r, g, b) > 60
          : data[i + 3] > 100 && Math.abs(r - wanted[0]) + Math.abs(g - wanted[1]) + Math.abs(b - wanted[2]) < 60;
      if (!counts) continue;
      const x = (i >> 2) % copy.width;
      count += 1;
      [left, right] = [Math.min(left, x), Math.max(right, x)];
    }
    return { count, width: Math.max(0, right - left) };
  }, colour);

onMadeUp('a path and a text that were cut short are read again', async (page) => {
  const chunk = Buffer.alloc(12 + 2 * 21);
  chunk.writeUInt32LE(2, 0);
  let requests = { path: 0, text: 0 };
  await page.route('**/path/again*', (route) => {
    requests.path += 1;
    return requests.path === 1 ? route.abort() : route.fulfill({ body: chunk, contentType: 'application/octet-stream' });
  });
  await page.route('**/programs/again*', (route) => {
    requests.text += 1;
    return requests.text === 1 ? route.abort() : route.fulfill({ body: 'G0 X0\nM2\n', contentType: 'text/plain' });
  });
  const load = (what) =>
    page.evaluate(async (what) => {
      const { path } = await import('/src/path/store.svelte.ts');
      const { programText } = await import('/src/lib/program-text.svelte.ts');
      if (what === 'load') {
        path.load('path/again.ngc', 'again/1');
        programText.load('programs/again.ngc?1');
      }
      return { note: path.note !== '', vertices: path.programmed.length, failed: programText.failed !== '', lines: programText.lines };
    }, what);
  await load('load');
  await until('both failed', async () => {
    const seen = await load('look');
    return (seen.note && seen.failed) || seen;
  });
  // The server tells of the program on every connection.
  await load('load');
  await until('both are here', async () => {
    const seen = await load('look');
    return (!seen.note && !seen.failed && seen.vertices === 1 && seen.lines === 2) || seen;
  });
  // What is whole is not read again.
  await load('load');
  await page.waitForTimeout(200);
  assert.deepEqual(requests, { path: 2, text: 2 });
});

onMadeUp('a path view at rest draws nothing, and what moves is drawn', async (page) => {
  await ready(page);
  await page.evaluate(() => {
    globalThis.strokes = { whole: 0, styles: 0 };
    const clear = CanvasRenderingContext2D.prototype.clearRect;
    CanvasRenderingContext2D.prototype.clearRect = function (...words) {
      globalThis.strokes.whole += 1;
      clear.apply(this, words);
    };
    const style = globalThis.getComputedStyle;
    globalThis.getComputedStyle = (...words) => {
      globalThis.strokes.styles += 1;
      return style(...words);
    };
  });
  await view(page, 'path');
  const drawn = async (ms) => {
    await page.evaluate(() => Object.assign(globalThis.strokes, { whole: 0, styles: 0 }));
    await page.waitForTimeout(ms);
    return page.evaluate(() => ({ ...globalThis.strokes }));
  };
  await page.waitForTimeout(4000);
  // The trail is thinned further where its history has doubled: once, and not 60 times a second.
  const still = await drawn(2000);
  assert.ok(still.whole <= 2 && still.styles === 0, JSON.stringify(still));
  /** Pixels of the trail. */
  const trail = () =>
    page.locator(at('path-trail')).evaluate((element) => {
      const { data } = element.getContext('2d').getImageData(0, 0, element.width, element.height);
      let count = 0;
      for (let i = 3; i < data.length; i += 4) if (data[i] > 100) count += 1;
      return count;
    });
  const before = await trail();
  await page.locator(`${at('start')}:enabled`).click();
  await page.waitForTimeout(700);
  const moving = await drawn(1500);
  assert.ok(moving.whole > 5 && moving.styles === 0, JSON.stringify(moving));
  const grown = await trail();
  assert.ok(grown > before + 50, `${before} to ${grown}`);
  // What was appended is what is drawn whole: turning the view there and back draws it again.
  await page.locator(at('hold')).click();
  await page.waitForTimeout(500);
  const appended = await trail();
  await page.locator(at('path')).focus();
  await page.keyboard.press('ArrowLeft');
  await page.keyboard.press('ArrowRight');
  await page.waitForTimeout(300);
  const whole = await trail();
  assert.ok(Math.abs(whole - appended) < 0.15 * appended + 20, `${appended} appended, ${whole} whole`);
  await page.locator('.path .row button', { hasText: 'Clear trail' }).click();
  await until('no trail', async () => (await trail()) < 20 || trail());
});

onMadeUp('a long path comes to the scene by and by, and a press on it does not block', async (page) => {
  const found = await page.evaluate(async () => {
    const { PathStage } = await import('/src/path/stage.ts');
    const { LineRuns, pick } = await import('/src/path/pick.ts');
    const { View } = await import('/src/path/view.ts');
    const chunk = (number) => ({ position: new Float32Array(3 * 65_535).fill(number), feed: new Float32Array(65_535), line: new Uint32Array(65_535).fill(number), limit: new Uint8Array(65_535) });
    const chunks = Array.from({ length: 100 }, (_, i) => chunk(i + 1));
    const from = { generation: 7, replaced: 0, fastest: 1, chunks, programmed: [{ chunk: chunk(0), first: 0 }] };
    const stage = new PathStage();
    const sent = [];
    let frame = 0;
    const count = () => ((frame += 1), requestAnimationFrame(count));
    requestAnimationFrame(count);
    stage.update((request) => /^add/.test(request.kind) && sent.push({ frame, lines: 'line' in (request.chunk ?? request.programmed.chunk) }), from);
    const atOnce = sent.length;
    while (sent.length < 101 && frame < 500) await new Promise(requestAnimationFrame);
    const perFrame = Math.max(...Object.values(Object.groupBy(sent, (entry) => entry.frame)).map((list) => list.length));
    // A press: others come to turn while 6.5 million vertices are looked at, and another press ends it.
    const view = Object.assign(new View(), { width: 100, height: 100 });
    let turns = 0;
    const timer = setInterval(() => (turns += 1), 0);
    const line = await pick(chunks, view, 50, 50, new AbortController().signal);
    clearInterval(timer);
    const other = new AbortController();
    const given = pick(chunks, view, 50, 50, other.signal);
    other.abort();
    // Chunks that come while a line is chosen.
    const runs = new LineRuns();
    let searches = 0;
    for (const one of chunks.slice(0, 20)) {
      const search = one.line.indexOf;
      one.line.indexOf = (...words) => ((searches += 1), search.apply(one.line, words));
    }
    const lengths = [];
    for (let i = 1; i <= 20; i += 1) lengths.push(runs.of(chunks.slice(0, i), 5).length);
    const gone = runs.of(chunks.slice(10, 20), 5).length;
    return { atOnce, all: sent.length, perFrame, withLines: sent.filter(({ lines }) => lines).length, line, turns: turns > 2, given: await given, searches, lengths, gone };
  });
  assert.deepEqual(
    { ...found, perFrame: found.perFrame <= 4, searches: found.searches <= 21 },
    { atOnce: 2, all: 101, perFrame: true, withLines: 0, line: 1, turns: true, given: null, searches: true, lengths: [0, 0, 0, 0, ...Array(16).fill(1)], gone: 0 },
  );
});

onMadeUp('a thinned chunk ends where it ends', async (page) => {
  const faults = await page.evaluate(async () => {
    const { indexCount, indexOf } = await import('/src/path/scene.ts');
    const [RUN, MAX, RESTART] = [64, 65_535, 0xffff];
    const found = [];
    for (const thinning of [1, 2, 16, 512]) {
      const list = [];
      if (thinning === 1) for (let i = 0; i < MAX; i += 1) list.push(i);
      else
        for (let begin = 0; begin < MAX - 1; begin += RUN * thinning) {
          for (let i = begin; i <= Math.min(begin + RUN, MAX - 1); i += 1) list.push(i);
          list.push(RESTART);
        }
      for (const count of [2, 3, 64, 65, 66, 128, 129, 130, 1000, 40_000, 65_534, MAX]) {
        const end = indexCount(count, thinning);
        const drawn = list.slice(0, end).filter((i) => i !== RESTART);
        // Of the shared indices those below the chunk's length, all of them and no others.
        const wanted = list.filter((i) => i !== RESTART && i < count);
        // Where a run begins at the last vertex it is no line: it may be missing.
        if (Math.max(...drawn) >= count || Math.abs(drawn.length - wanted.length) > 1) found.push([thinning, count, drawn.length, wanted.length]);
        if (indexOf(count - 1, thinning) > end) found.push([thinning, count, 'begins after its end']);
      }
    }
    return found;
  });
  assert.deepEqual(faults, []);
});

onMadeUp('a picture that loses its graphics comes back, and a worker that fails is told', async (page, context) => {
  // The first worker never begins: what is asked for then is loaded into the page.
  let requests = 0;
  // The page before may still ask for one.
  page.once('framenavigated', () => {
    requests = 0;
  });
  await page.route(/scene\.worker.*worker_file/, (route) => {
    requests += 1;
    return requests === 1 ? route.fulfill({ body: '', contentType: 'text/javascript' }) : route.continue();
  });
  await page.reload();
  await page.locator(at('lease')).waitFor();
  await view(page, 'path');
  const coloured = async () => (await pixels(page.locator(at('path-picture')))).count;
  const isDrawn = (what) => until(what, async () => (await coloured()) > 500 || coloured(), 30_000);
  await isDrawn('in the page');
  const lose = () =>
    page.evaluate(() => {
      const element = document.querySelector('[data-test="path-picture"]');
      element.dataset.lost = 'yes';
      globalThis.losing = element.getContext('webgl2').getExtension('WEBGL_lose_context');
      globalThis.losing.loseContext();
    });
  await lose();
  await page.waitForTimeout(300);
  await page.evaluate(() => globalThis.losing.restoreContext());
  await isDrawn('restored');
  assert.equal(await page.locator('[data-lost]').count(), 1, 'the same scene');
  // One that does not come back is replaced.
  await lose();
  await until('a new scene', async () => (await page.locator('[data-lost]').count()) === 0, 20_000);
  await isDrawn('in the new scene');
});

anywhere('two fingers zoom the path', async (page, context) => {
  if (context.real) {
    await takeControl(page);
    await upload(page, 'pinch.ngc', square(100, 3000));
  }
  await view(page, 'path');
  await page.locator(at('path-plan')).click();
  const extent = async () => (await pixels(page.locator(at('path-picture')))).width;
  await until('the path', async () => (await extent()) > 100 || extent(), 20_000);
  await page.waitForTimeout(800);
  const before = await extent();
  const box = await page.locator(at('path')).boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const session = await page.context().newCDPSession(page);
  const touch = (type, apart) => session.send('Input.dispatchTouchEvent', { type, touchPoints: apart === null ? [] : [{ x: x - apart, y, id: 1 }, { x: x + apart, y, id: 2 }] });
  await touch('touchStart', 100);
  for (let apart = 95; apart >= 50; apart -= 5) await touch('touchMove', apart);
  await touch('touchEnd', null);
  await until('half as wide', async () => Math.abs((await extent()) / before - 0.5) < 0.1 || [await extent(), before]);
});

onMachine('the path is drawn, and a press on it chooses its line in the program', async (page, context) => {
  await takeControl(page);
  await upload(page, 'path.ngc', square(100, 3000));
  await view(page, 'path');
  await page.locator(at('path-plan')).click();
  const canvas = page.locator(at('path-picture'));
  const coloured = async () => (await pixels(canvas)).count;
  await until('coloured pixels', async () => (await coloured()) > 300 || coloured(), 20_000);
  await page.waitForTimeout(500);
  const box = await page.locator(at('path')).boundingBox();
  // The square fills 88 % of the height: its right edge is line 3.
  await page.mouse.click(box.x + box.width / 2 + 0.44 * box.height, box.y + box.height / 2);
  await until('line 3', async () => /line 3/.test(await page.locator('.holder .note').innerText()) || page.locator('.holder .note').innerText());
  await view(page, 'program');
  await page.locator('[data-line="3"][aria-selected="true"]').waitFor();
});

onMachine('the path is coloured by what limits it, in the box of its stock', async (page, context) => {
  await takeControl(page);
  await upload(page, 'limits.ngc', square(60, 3000));
  await view(page, 'path');
  await page.locator(at('path-plan')).click();
  const canvas = page.locator('.holder canvas');
  const green = async () => (await pixels(canvas.nth(0), [38, 166, 64])).count;
  const blue = async () => (await pixels(canvas.nth(1), [7, 90, 156])).count;
  await page.locator(at('path-by-limit')).click();
  // At F3000 the feed word limits nearly all of it: green.
  await until('green', async () => (await green()) > 200 || green(), 20_000);
  const before = await blue();
  await page.locator(at('path-stock')).click();
  for (const [row, values] of [[0, ['-5', '-5', '-10']], [1, ['65', '65', '0']]]) {
    for (const [i, letter] of ['X', 'Y', 'Z'].entries()) await page.locator(at(`stock-${row}-${letter}`)).fill(values[i]);
  }
  await page.locator(at('stock-ok')).click();
  await until('a box', async () => (await blue()) > before + 200 || blue());
});
