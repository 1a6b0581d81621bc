// Views of a lathe.
import assert from 'node:assert/strict';
import { at, ready, text, until, view } from '../operator.mjs';
import { onMachine, onMadeUp } from '../case.mjs';

onMadeUp('X of a lathe is a diameter in G7 and a radius in G8, and says so wherever it stands', async (page) => {
  await ready(page);
  const is = (what, wanted) => until(`${what} is ${wanted}`, async () => (await text(page, what)) === wanted || text(page, what));
  assert.equal(await text(page, 'letter-X'), 'X', 'a mill has neither');
  await page.evaluate(() => {
    const axis = { kind: 'linear', min: -300, max: 300, maxVelocity: 300, isUnlimited: false, hasHomeSwitch: true };
    globalThis.changeMadeUpMachine({ kind: 'lathe', axes: [{ ...axis, letter: 'X' }, { ...axis, letter: 'Z' }] });
    globalThis.changeMadeUp({ machine: [20, 100, 0], workOffset: [0, 0, 0], modal: ['G18', 'G8', 'G21', 'G54'] });
    globalThis.tellMadeUp({ kind: 'offsets', offsets: [{ system: 1, values: [1.5, 2.5], rotation: 0 }] });
    globalThis.tellMadeUp({ kind: 'tools', tools: [{ number: 3, offsets: [0.25, 0.5], diameter: 0, orientation: 2, angles: [95, 155], comment: 'roughing' }] });
  });
  const figures = () => page.evaluate(async () => (await import('/src/lib/session.svelte.ts')).session.status.workOffset.slice(0, 2));
  const touch = async (value, unit) => {
    await view(page, 'jog');
    await page.locator(`${at('touch-X')}:enabled`).click();
    assert.equal(await text(page, 'touch-unit'), unit);
    await page.locator(at('touch-value')).fill(value);
    await page.locator(at('touch-ok')).click();
    await is('large-X', `${value}.000`);
  };
  // A measured diameter of 30 at 20 mm from the centre of the machine: the zero is at 5 mm.
  await is('large-X', '20.000');
  await is('letter-X', 'XR');
  await touch('15', 'mm, radius');
  await until('R', async () => JSON.stringify(await figures()) === '[5,0]' || figures());
  await page.evaluate(() => globalThis.changeMadeUp({ workOffset: [0, 0, 0], modal: ['G18', 'G7', 'G20', 'G54'] }));
  await is('letter-X', 'X⌀');
  await is('large-X', '40.000');
  await is('large-Z', '100.000');
  await touch('30', 'mm, diameter');
  await until('⌀', async () => JSON.stringify(await figures()) === '[5,0]' || figures());
  await is('other-X', '40.000');
  await page.locator(at('touch-Z')).click();
  assert.deepEqual([await text(page, 'touch-unit'), await page.locator(at('touch-inch')).count()], ['mm', 1]);
  await page.keyboard.press('Escape');
  // Tables: what is shown and what is set.
  await view(page, 'offsets');
  assert.equal(await text(page, 'offset-head-X'), 'X ⌀');
  assert.deepEqual([await page.locator(at('offset-G54-X')).inputValue(), await page.locator(at('offset-G54-Z')).inputValue()], ['3.000', '2.500']);
  await page.locator(at('offset-G54-X')).fill('7');
  await page.keyboard.press('Enter');
  await view(page, 'tools');
  assert.equal(await text(page, 'tool-head-X'), 'X ⌀');
  assert.deepEqual([await text(page, 'tool-3-orientation'), await text(page, 'tool-3-angles'), await text(page, 'tool-3-comment')], ['2', '95.0 / 155.0', 'roughing']);
  assert.deepEqual([await page.locator(at('tool-3-X')).inputValue(), await page.locator(at('tool-3-Z')).inputValue()], ['0.500', '0.500']);
  await page.locator(at('tool-3-X')).fill('9');
  await page.keyboard.press('Enter');
  const values = () => page.evaluate(() => globalThis.madeUpOrders.filter(({ name }) => name === 'work_offset' || name === 'tool').map(({ values }) => values[0].value).join());
  await until('half of it', async () => (await values()) === '3.5,4.5' || values());
  await page.evaluate(() => globalThis.changeMadeUp({ modal: ['G18', 'G8', 'G21', 'G54'] }));
  await until('R again', async () => (await text(page, 'tool-head-X')) === 'X R');
});

onMadeUp('a pass of a lathe is told in the work coordinates in which it was cut', async (page) => {
  const found = await page.evaluate(async () => {
    const { History } = await import('/src/lib/session.svelte.ts');
    const { PassFinder } = await import('/src/cut/passes.ts');
    const history = new History(2, 1000);
    const finder = new PassFinder(undefined);
    const sample = (time, x, z, speed) => ({ time, line: 1, rapid: false, feed: 1, position: [x, z], velocity: [0, speed], acceleration: [0, 0], error: null, load: null });
    // X zero at 5 and a tool 1.5 long in X, then another work zero before the pass ends up in the list.
    for (let i = 0; i <= 20; i += 1) history.push(sample(i, 26.5, 120 - i, -1), { latenessNs: 0, workOffset: [5, 100], toolOffset: [1.5, 0] });
    history.push(sample(21, 26.5, 100, 0), { latenessNs: 0, workOffset: [0, 0], toolOffset: [0, 0] });
    finder.follow(history, 1, 0);
    return finder.passes.map(({ from, to, across }) => [from, to, across]);
  });
  assert.deepEqual(found, [[20, 0, 20]]);
});

onMachine('a lathe shows its stock, its passes, and the limits of chatter with the present speed', async (page) => {
  if ((await page.locator('[data-view="cut"]').count()) === 0) return 'not measured';
  await ready(page);
  await view(page, 'mdi');
  for (const block of ['G18 G21 G90 G94', 'G53 G0 X40', 'G53 G0 Z260', 'M3 S3000', 'G1 Z230 F3000', 'G0 X45', 'G0 Z260', 'G0 Z250']) {
    await page.locator(at('mdi-block')).fill(block);
    await page.locator(at('mdi-run')).click();
    await until(block, async () => (await page.locator(at('mdi-block')).inputValue()) === '' && (await text(page, 'state')) === 'Ready', 20_000);
  }
  await view(page, 'cut');
  // The way from 260 to 230 is a pass; the way back is none, nor is a rapid.
  await until('a pass', async () => /260\.00 … 230\.00/.test(await text(page, 'passes')) || text(page, 'passes'));
  assert.equal(await page.locator(`${at('passes')} tbody tr`).count(), 1);
  assert.match((await page.locator(`${at('passes')} thead`).innerText()).replace(/\s+/g, ' '), /Z, mm X (R|⌀), mm/);
  assert.match(await text(page, 'load'), /not measured[\s\S]*set load 2200/);
  await page.locator(at('cut-chatter')).click();
  // Y. Altintas's example: 7.185 mm are stable at every speed.
  await until('the limit', async () => /S3000: stable up to a depth of/.test(await text(page, 'chatter-here')) || text(page, 'chatter-here'), 60_000);
  const limit = Number(/depth of ([0-9.]+) mm/.exec(await text(page, 'chatter-here'))[1]);
  assert.ok(limit >= 7.184 && limit < 40, `${limit}`);
  // A mill whose delay equation chatters at no depth at this speed and was not solved at another, as the core answers.
  const point = (speed_rpm, method, limit_mm, exact_limit_mm) => ({ speed_rpm, method, limit_mm, exact_limit_mm });
  const points = (rpm) => [point(2000, 'delay-equation', 1, 1), point(rpm, 'delay-equation', 2, null), point(4000, 'zero-order', 3, null)];
  const notes = ['no limit of the delay equation at 4000 rpm'];
  // At its point and beside it: between a limit and none the limit counts.
  for (const [rpm, depth] of [[3000, '5.000'], [3001, '1.000']]) {
    const lobes = [{ kind: 'milling', max_depth_mm: 5, points: points(rpm), notes }];
    await page.route('**/chatter', (route) => route.fulfill({ json: { case: 'a mill', description: '', oscillation: null, lobes } }));
    await view(page, 'mdi');
    await view(page, 'cut');
    await page.locator(at('cut-chatter')).click();
    await until('the mill', async () => (await text(page, 'chatter-here')) === `S3000: stable up to a depth of ${depth} mm` || text(page, 'chatter-here'));
    assert.equal(await text(page, 'lobes-note'), notes[0]);
    await page.unroute('**/chatter');
  }
});
