// Recorded runs.
import assert from 'node:assert/strict';
import { at, number, ready, square, text, until, upload, view } from '../operator.mjs';
import { onMachine, onMadeUp } from '../case.mjs';

onMachine('time, line and point of the path of a recorded run lead to each other', async (page) => {
  await ready(page);
  for (const feed of [3000, 6000]) {
    await upload(page, `run-${feed}.ngc`, square(30, feed));
    await until('planned', async () => (await page.locator(at('planned')).count()) === 1, 20_000);
    await page.locator(at('start')).click();
    await until('runs', async () => (await text(page, 'state')) === 'Program' || text(page, 'state'));
    await until('done', async () => (await text(page, 'state')) === 'Ready' || text(page, 'state'), 20_000);
  }
  // What is being recorded is flushed four times a second.
  await page.waitForTimeout(600);
  await view(page, 'traces');
  await page.locator(at('trace-list')).locator('button').first().click();
  await page.locator(at('trace-readout')).waitFor({ timeout: 30_000 });
  const shown = await page.locator(at('trace-job')).locator('option:checked').innerText();
  assert.match(shown, /run-6000\.ngc/, 'the program that was run last');
  const place = async () => Object.fromEntries([...(await text(page, 'trace-place')).matchAll(/([XYZ]) ([-0-9.]+)/g)].map(([, letter, value]) => [letter, Number(value)]));
  const corner = await place();
  // Line to time and point: line 3 goes up from (30, 0), line 4 back from (30, 30).
  await page.locator('[data-trace-line="3"]').click();
  assert.equal(await text(page, 'trace-line'), '3');
  const [third, at3] = [await number(page, 'trace-time'), await place()];
  await page.locator('[data-trace-line="4"]').click();
  const [fourth, at4] = [await number(page, 'trace-time'), await place()];
  assert.ok(third > 0.25 && fourth > third + 0.25, `${third}, ${fourth}`);
  for (const [seen, x, y] of [[at3, 30, 0], [at4, 30, 30]]) {
    assert.ok(Math.hypot(seen.X - corner.X - x, seen.Y - corner.Y - y) < 0.2, JSON.stringify([corner, seen]));
  }
  // Time to line and point: the middle of line 3.
  const scrub = page.locator(at('trace-scrub'));
  const [from, to] = await scrub.evaluate((element) => [Number(element.min), Number(element.max)]);
  const cycle = await scrub.evaluate((element) => Number(element.value));
  const perSecond = (cycle - from) / fourth;
  await scrub.fill(String(Math.round(from + perSecond * ((third + fourth) / 2))));
  assert.equal(await text(page, 'trace-line'), '3');
  const middle = await place();
  assert.ok(Math.abs(middle.X - corner.X - 30) < 0.02 && middle.Y - corner.Y > 5 && middle.Y - corner.Y < 25, JSON.stringify([corner, middle]));
  await scrub.press('ArrowRight');
  assert.ok(Math.abs((await number(page, 'trace-time')) - (third + fourth) / 2 - 0.01) < 0.003, 'an arrow goes by 10 ms');
  assert.ok(to > cycle);
  // Point to time and line: the middle of the left edge is of line 5.
  await page.locator(at('trace-plan')).click();
  const box = await page.locator(at('trace-path')).boundingBox();
  const side = 0.88 * Math.min(box.width, box.height);
  await page.mouse.click(box.x + box.width / 2 - side / 2, box.y + box.height / 2);
  assert.equal(await text(page, 'trace-line'), '5');
  const left = await place();
  assert.ok(Math.abs(left.X - corner.X) < 0.02 && Math.abs(left.Y - corner.Y - 15) < 2, JSON.stringify([corner, left]));
  // The report is a page in a frame of its own origin.
  await page.locator(at('traces-report')).click();
  const frame = page.frameLocator(at('trace-report'));
  await frame.locator('#verdict li').first().waitFor({ timeout: 30_000 });
  await until('curves are drawn', async () => (await frame.locator('#charts canvas').count()) > 3);
  // The two programs of this session.
  await page.locator(at('traces-compare')).click();
  await until('jobs', async () => (await page.locator(at('compare-job-b')).count()) === 1, 20_000);
  assert.match(await page.locator(at('compare-job-a')).locator('option:checked').innerText(), /run-3000/);
  await page.locator(at('compare-run')).click();
  await page.locator(at('comparison')).waitFor({ timeout: 30_000 });
  const found = await text(page, 'comparison');
  const [, less] = /time of B minus that of A is (-?[0-9.]+) s/.exec(found) ?? [];
  assert.ok(Number(less) < -0.8 && Number(less) > -2.5, found);
  assert.match(found, /the programs differ|same path|differ by/);
  // A line that is another one in B shows both texts.
  assert.match(await page.locator(at('compare-b-text')).first().innerText(), /^B: .*F6000/);
});

onMadeUp('of a long line the path around the present time is marked', async (page) => {
  const found = await page.evaluate(async () => {
    const { around } = await import('/src/traces/run-data.ts');
    return [[10, 19, 15, 100], [10, 19, 15, 10], [10, 19, 10, 4], [10, 19, 15, 4], [10, 19, 19, 4], [10, 9, 9, 4]].map((of) => around(...of)).map(({ begin, end }) => [begin, end]);
  });
  // A whole line, one that fits, its start, its middle and its end, and one without points.
  assert.deepEqual(found, [[10, 19], [10, 19], [10, 13], [13, 16], [16, 19], [10, 9]]);
});

onMadeUp('while a report is computed its frame says so', async (page) => {
  const trace = { name: 'a.mcap', program: 'a.ngc', is_open: false, started: 0, modified: 1, duration_s: 1, bytes: 1, problem: '' };
  await page.route('**/traces', (route) => route.fulfill({ json: [trace, { ...trace, name: 'b.mcap' }] }));
  await page.route('**/traces/*/data', (route) => route.fulfill({ status: 404, body: 'made up' }));
  let answer = () => {};
  await page.route('**/traces/*/report', async (route) => {
    await new Promise((resolve) => (answer = resolve));
    await route.fulfill({ body: '<p>made up</p>', contentType: 'text/html' });
  });
  await view(page, 'traces');
  for (const index of [0, 1]) {
    await page.locator(at('traces-list')).click();
    await page.locator(at('trace-list')).locator('button').nth(index).click();
    await page.locator(at('traces-report')).click();
    await until('its text', async () => (await text(page, 'report-computing')) === 'The report is being computed …');
    await page.waitForTimeout(300);
    assert.equal(await page.locator(at('report-computing')).isVisible(), true);
    answer();
    await page.locator(at('report-computing')).waitFor({ state: 'detached' });
    assert.equal(await page.locator(at('trace-report')).isVisible(), true);
    await page.frameLocator(at('trace-report')).getByText('made up').waitFor();
  }
});
