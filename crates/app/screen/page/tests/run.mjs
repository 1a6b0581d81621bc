import { cases } from './all.mjs';
import { HostWatch } from './host_watch.mjs';
import { at, takeControl } from './operator.mjs';

/** Attempts at a case that fails while the host gives no time. */
const ATTEMPTS = 3;
/** A pause of the host from which on a failure may be the host's, ms: a jog whose page gets no time for 90 ms ends by itself. */
const PAUSE_MS = 90;
/** A page is there by then, ms: beside other tests on two cores the first one takes more than half a minute. */
export const LOADED_MS = 120_000;

async function open(page, url) {
  await page.goto(url, { timeout: LOADED_MS });
  await page.locator(at('lease')).waitFor({ timeout: LOADED_MS });
}

/** Runs a case once in a fresh page at 1024 x 600; gives 'ok', 'not measured' or the error. */
async function attempt(browser, url, run, context) {
  const own = await browser.newContext({ viewport: { width: 1024, height: 600 }, locale: 'en', colorScheme: 'light' });
  const page = await own.newPage();
  const errors = [];
  page.on('pageerror', (error) => errors.push(error.message));
  page.on('console', (message) => message.type() === 'error' && errors.push(message.text()));
  try {
    await open(page, url);
    const measured = await run(page, context);
    if (errors.length > 0) throw new Error(`errors in the page: ${errors.join('; ')}`);
    return measured === 'not measured' ? measured : 'ok';
  } catch (error) {
    return error;
  } finally {
    await own.close();
  }
}

/**
 * Ends what a case may have left that was broken off, or in which the host paused: a machine in motion, a program under way, and the alarm
 * of drives that were not heard for as long, which keeps the power off. Gives the alarm's text.
 */
async function settle(browser, url) {
  const page = await browser.newPage({ viewport: { width: 1024, height: 600 }, locale: 'en' });
  await open(page, url);
  await page.locator(at('estop')).click();
  let alarm = '';
  if (await page.locator(at('alarms')).isEnabled()) {
    await takeControl(page);
    await page.locator(at('alarms')).click();
    alarm = (await page.locator(at('alarm-list')).innerText()).replace(/\s+/g, ' ');
    await page.locator(at('alarm-list')).getByText('Clear alarms').click();
    await page.locator(`${at('alarms')}:disabled`).waitFor();
  }
  await page.close();
  return alarm;
}

/**
 * Runs the chosen cases; gives how many failed. One that fails while the host pauses, or with an alarm that the machine gives then, runs
 * again.
 */
export async function runCases(browser, url, context, chosen) {
  const failed = [];
  for (const { name, run, need } of cases.filter(chosen)) {
    if (need && !context[need]) {
      console.log(`not measured: ${name}`);
      continue;
    }
    const begin = Date.now();
    for (let count = 1; ; count += 1) {
      const watch = new HostWatch();
      const result = await attempt(browser, url, run, context);
      const pause = watch.end();
      const passed = typeof result === 'string';
      const alarm = context.real && (!passed || pause > PAUSE_MS) ? await settle(browser, url).catch((error) => error.message) : '';
      const host = `the host paused for up to ${pause.toFixed(0)} ms${alarm && `; alarm: ${alarm}`}`;
      if (passed) {
        const took = `${((Date.now() - begin) / 1000).toFixed(1)} s`;
        console.log(`${result === 'ok' ? 'ok     ' : 'not measured:'} ${name} (${took}${alarm && `, ${host}`})`);
        break;
      }
      const again = (pause > PAUSE_MS || alarm !== '') && count < ATTEMPTS;
      console.log(`${again ? 'again  ' : 'FAILED '} ${name} (${host})\n${result.message}`);
      if (!again) {
        failed.push(name);
        break;
      }
    }
  }
  if (failed.length > 0) console.log(`failed: ${failed.join('; ')}`);
  return failed.length;
}
