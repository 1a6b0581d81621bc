import { at, cases } from './cases.mjs';

/** Runs the cases whose name has `only` in it, each in a fresh page at 1024 x 600; gives how many failed. */
export async function runCases(browser, url, only, context) {
  let failed = 0;
  for (const [name, run] of Object.entries(cases)) {
    if (!name.includes(only)) continue;
    const own = await browser.newContext({ viewport: { width: 1024, height: 600 }, locale: 'en', colorScheme: 'light' });
    const page = await own.newPage();
    const errors = [];
    page.on('pageerror', (error) => errors.push(error.message));
    page.on('console', (message) => message.type() === 'error' && errors.push(message.text()));
    try {
      await page.goto(url);
      await page.locator(at('lease')).waitFor();
      const measured = await run(page, context);
      if (errors.length > 0) throw new Error(`errors in the page: ${errors.join('; ')}`);
      console.log(`${measured === 'not measured' ? 'not measured:' : 'ok     '} ${name}`);
    } catch (error) {
      failed += 1;
      console.log(`FAILED  ${name}\n${error.message}`);
    }
    await own.close();
  }
  return failed;
}
