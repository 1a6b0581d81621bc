// Pictures of every view for the docs, each of a real service: `node tests/pictures.mjs BINARY FOLDER`. The mill has simulated drives, the lathe
// drives that cut a stock.
import { spawn } from 'node:child_process';
import { readFileSync } from 'node:fs';
import { join, resolve } from 'node:path';
import { launch } from './browser.mjs';
import { at, ready, takeControl, text, until, view } from './operator.mjs';
import { ownBus, root, serve } from './service.mjs';

const [binary, folder, only = ''] = process.argv.slice(2);
if (folder === undefined) throw new Error('node tests/pictures.mjs BINARY FOLDER [run|mill|lathe|router]');
const browser = await launch();
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

async function open(url, width = 1024, height = 600, language = 'en', theme = 'light') {
  const context = await browser.newContext({ viewport: { width, height }, locale: language, colorScheme: theme });
  const page = await context.newPage();
  await page.goto(url);
  await page.locator(at('lease')).waitFor();
  return page;
}

const shoot = (page, name) => page.screenshot({ path: join(folder, `screen-${name}.png`) });
const state = (page) => text(page, 'state');

async function loaded(page, file, isPlanned = true) {
  await view(page, 'program');
  await page.locator(at('program-file')).setInputFiles(file);
  await until('checked', async () => /error|warning/.test(await text(page, 'findings-button')), 60_000);
  if (isPlanned) await until('planned', async () => (await page.locator(at('planned')).count()) === 1, 60_000);
}

async function mdi(page, blocks) {
  await view(page, 'mdi');
  for (const block of blocks) {
    await page.locator(at('mdi-block')).fill(block);
    await page.locator(`${at('mdi-run')}:enabled`).click();
    await until(block, async () => ((await page.locator(at('mdi-block')).inputValue()) === '' && (await state(page)) === 'Ready') || state(page), 30_000);
  }
}

/** A service with drives is ready once they are in operation. */
async function up(page) {
  await until('feedback', async () => !/no feedback|400/.test(await text(page, 'advice')), 10_000);
  await ready(page);
}

/** The example of the first page of the documentation: a run, looked at. */
async function run() {
  const words = ['run', 'tests/programs/bore-200.ngc', '--machine', 'config/machines/mill-3axis.toml', '--no-trace', '--screen=127.0.0.1:0', ...ownBus()];
  const child = spawn(resolve(binary), words, { cwd: root, stdio: ['ignore', 'ignore', 'pipe'] });
  process.on('exit', () => child.kill('SIGKILL'));
  let said = '';
  child.stderr.on('data', (data) => (said += data));
  await until('the address', () => /http:\S+/.test(said) || said, 60_000);
  const page = await open(said.match(/http:\S+/)[0]);
  await view(page, 'path');
  // In a cut, with some of its path behind it.
  await sleep(12_000);
  await until('a distance to go', async () => /[1-9]/.test(await text(page, 'togo-X')) || text(page, 'togo-X'), 20_000);
  await shoot(page, 'run');
  await page.context().close();
  const ended = new Promise((resolve) => child.once('exit', resolve));
  child.kill('SIGINT');
  await ended;
}

async function mill() {
  const service = await serve(binary, {
    // A host that draws pictures is late, and so are drives that it simulates.
    changes: [['# max_late_cycles = 1000', 'max_late_cycles = 0'], ['feedback_timeout_ms = 20 ', 'feedback_timeout_ms = 1000 ']],
    files: { 'macros.toml': readFileSync(join(root, 'config/macros/mill.toml')) },
    options: (own) => [`--screen-macros=${join(own, 'macros.toml')}`],
    drives: () => [],
  });
  const page = await open(service.url);
  await up(page);
  await mdi(page, ['G10 L1 P1 Z42.5 R5', 'G10 L1 P2 Z61.25 R3', 'G10 L1 P3 Z38 R8', 'G10 L2 P1 X33.25 Y-14.5 Z0', 'G10 L2 P2 X-120 Y80 Z-35']);
  await loaded(page, join(root, 'tests/programs/bore-200.ngc'));
  await view(page, 'path');
  await sleep(3000);
  await takeControl(page);
  await page.locator(at('start')).click();
  await sleep(9000);
  for (const name of ['path', 'program', 'scope', 'jog', 'mdi', 'offsets', 'tools']) {
    await view(page, name);
    // With its pad.
    if (name === 'jog') await page.locator(at('increment-0')).click();
    await sleep(1800);
    await shoot(page, name);
  }
  await view(page, 'path');
  const wide = await open(service.url, 1920, 1080, 'de', 'dark');
  await view(wide, 'program');
  // A browser that draws by software compiles for seconds before the path is there.
  await sleep(10_000);
  await shoot(wide, 'wide');
  await wide.context().close();
  // Held, and left by a jog.
  await view(page, 'jog');
  // A slow host has come to the program's end meanwhile.
  if ((await state(page)) === 'Ready') await page.locator(at('start')).click();
  await page.locator(`${at('hold')}:enabled`).click();
  await until('held', async () => (await state(page)) === 'Held' || state(page), 20_000);
  await sleep(1000);
  await page.locator(at('increment-10')).click();
  await page.locator(at('jog-Z-plus')).click();
  await page.locator(`${at('return')}:enabled`).waitFor();
  await sleep(500);
  await shoot(page, 'held');
  await page.locator(at('return')).click();
  await page.locator(`${at('resume')}:enabled`).waitFor();
  await page.locator(at('resume')).click();
  await until('its end', async () => (await state(page)) === 'Ready' || state(page), 120_000);
  await view(page, 'path');
  await page.getByRole('button', { name: 'Clear trail' }).click();
  await page.locator(at('path-by-limit')).click();
  await sleep(2500);
  await shoot(page, 'limits');
  await view(page, 'program');
  await page.locator('[data-line="12"]').click();
  await page.locator(at('run-from')).click();
  await page.locator(`${at('run-from-way')} li`).first().waitFor();
  await sleep(500);
  await shoot(page, 'start-at');
  await page.keyboard.press('Escape');
  // A second run at another feed, to compare.
  await page.locator('#feed_override').fill('90');
  await sleep(300);
  await page.locator(at('start')).click();
  await until('runs', async () => (await state(page)) === 'Program' || state(page));
  await until('its end', async () => (await state(page)) === 'Ready' || state(page), 200_000);
  await page.locator(at('feed_override')).click();
  await sleep(1000);
  await view(page, 'traces');
  await page.locator(at('trace-list')).locator('button').first().click();
  await page.locator(at('trace-readout')).waitFor({ timeout: 60_000 });
  const [from, to] = await page.locator(at('trace-scrub')).evaluate((element) => [Number(element.min), Number(element.max)]);
  await page.locator(at('trace-scrub')).fill(String(Math.round(from + 0.6 * (to - from))));
  await sleep(1500);
  await shoot(page, 'traces');
  await page.locator(at('traces-report')).click();
  await page.frameLocator(at('trace-report')).locator('#verdict li').first().waitFor({ timeout: 60_000 });
  await sleep(1500);
  await shoot(page, 'report');
  await page.locator(at('traces-compare')).click();
  await page.locator(at('compare-job-b')).waitFor({ timeout: 60_000 });
  for (const [side, place] of [['a', 0], ['b', -1]]) {
    const jobs = await page.locator(at(`compare-job-${side}`)).locator('option').evaluateAll((list) => list.filter((option) => /bore-200/.test(option.textContent)).map((option) => option.value));
    await page.locator(at(`compare-job-${side}`)).selectOption(jobs.at(place));
  }
  await page.locator(at('compare-run')).click();
  await page.locator(at('comparison')).waitFor({ timeout: 60_000 });
  await sleep(1000);
  await shoot(page, 'compare');
  await page.context().close();
  await service.end();
}

async function lathe() {
  const shaft = readFileSync(join(root, 'config/processes/turn-shaft.toml'), 'utf8')
    .replace('length_mm = 200.0', 'length_mm = 12.0')
    .replace('[[0.0, 10.0], [200.0, 5.0]]', '[[0.0, 9.0], [12.0, 7.5]]')
    // A host that draws pictures delivers readings late.
    .replace('stale_ms = 10.0', 'stale_ms = 100.0');
  const service = await serve(binary, {
    machine: 'lathe-2axis',
    changes: [['rate = "rational"', 'rate = 500']],
    files: { 'shaft.toml': shaft, 'shaft.ngc': 'G21 G18 G90 G94 G8\nS200 M3\nG0 Z308\nG0 X39.5\nG0 Z300\nF200\nG82 X60 Z288 Q1\nM2\n' },
    options: (own) => [`--process=${join(own, 'shaft.toml')}`, `--process=${join(root, 'config/processes/lobes-turning.toml')}`],
    drives: (own) => ['--process', join(own, 'shaft.toml')],
  });
  const page = await open(service.url);
  await up(page);
  // Its passes depend on the load, so that nobody knows its time.
  await loaded(page, join(service.folder, 'shaft.ngc'), false);
  await takeControl(page);
  await page.locator(at('start')).click();
  await view(page, 'cut');
  await until('runs', async () => (await state(page)) === 'Program' || state(page));
  await until('passes', async () => (await page.locator('[data-test="passes"] tbody tr').count()) >= 2 || state(page), 60_000).catch(() => {});
  await sleep(2000);
  await shoot(page, 'turning');
  if (!(await page.locator(at('stop')).isDisabled())) await page.locator(at('stop')).click();
  await until('rest', async () => (await state(page)) === 'Ready' || state(page), 20_000);
  await mdi(page, ['M3 S5200']);
  await view(page, 'cut');
  await page.locator(at('cut-chatter')).click();
  await until('limits', async () => /stable/.test(await text(page, 'chatter-here')), 60_000);
  await sleep(600);
  await shoot(page, 'chatter');
  await page.context().close();
  await service.end();
}

/** Signals; a rejection, and its place in the documentation. */
async function router() {
  const service = await serve(binary, { machine: 'router-3axis', drives: () => [] });
  const page = await open(service.url);
  await up(page);
  await view(page, 'io');
  await page.locator(at('on-dust-extraction')).click();
  await page.locator(`${at('on-dust-extraction')}[aria-pressed="true"]`).waitFor();
  await sleep(600);
  await shoot(page, 'io');
  await view(page, 'mdi');
  await page.locator(at('mdi-block')).fill('G1 X9999 F500');
  await page.locator(`${at('mdi-run')}:enabled`).click();
  await page.locator(at('rejection')).waitFor();
  await view(page, 'events');
  await sleep(500);
  await shoot(page, 'events');
  await page.locator(`${at('events')} [data-alarm]`).first().click();
  await page.locator(`${at('help')} iframe`).waitFor();
  await sleep(1500);
  await shoot(page, 'help');
  await page.context().close();
  await service.end();
}

if (only === 'run' || only === '') await run();
if (only === 'router' || only === '') await router();
if (only === 'mill' || only === '') await mill();
if (only === 'lathe' || only === '') await lathe();
await browser.close();
