// Overrides.
import assert from 'node:assert/strict';
import { at, ready, takeControl, text, until } from '../operator.mjs';
import { anywhere, onMadeUp } from '../case.mjs';

anywhere('overrides take effect and go back to 100 %', async (page) => {
  await takeControl(page);
  await page.locator('#feed_override').fill('50');
  await until('50 %', async () => (await text(page, 'feed_override')) === '50 %' || text(page, 'feed_override'));
  await page.locator(at('feed_override')).click();
  await until('100 %', async () => (await text(page, 'feed_override')) === '100 %' || text(page, 'feed_override'));
});

anywhere('overrides that change while a command is on its way all take effect', async (page) => {
  await ready(page);
  await page.evaluate(() => {
    for (const [name, percent] of [['feed', 50], ['feed', 40], ['rapid', 70], ['feed', 30], ['rapid', 60]]) {
      const slider = document.querySelector(`#${name}_override`);
      slider.value = String(percent);
      slider.dispatchEvent(new Event('input', { bubbles: true }));
      slider.dispatchEvent(new Event('change', { bubbles: true }));
    }
  });
  for (const [name, percent] of [['feed', '30 %'], ['rapid', '60 %']]) {
    await until(percent, async () => (await text(page, `${name}_override`)) === percent || text(page, `${name}_override`));
    await page.locator(at(`${name}_override`)).click();
  }
});

anywhere('an override takes any whole percent that its range has', async (page) => {
  await takeControl(page);
  const exact = page.locator(at('feed_override-exact'));
  const reads = (wanted) => until(wanted, async () => (await text(page, 'feed_override')) === wanted || text(page, 'feed_override'));
  await exact.fill('73');
  await exact.press('Enter');
  await reads('73 %');
  assert.equal(await exact.inputValue(), '');
  for (const wrong of ['201', '1.5', 'x']) {
    await exact.fill(wrong);
    assert.equal(await exact.getAttribute('aria-invalid'), 'true', wrong);
    await exact.press('Enter');
    await page.waitForTimeout(100);
    await reads('73 %');
  }
  // Leaving the field gives it up.
  await exact.fill('20');
  await exact.blur();
  await page.waitForTimeout(100);
  await reads('73 %');
  await page.locator(at('spindle_override-exact')).fill('9');
  assert.equal(await page.locator(at('spindle_override-exact')).getAttribute('aria-invalid'), 'true', 'below the least');
  await page.locator(at('feed_override')).click();
  await reads('100 %');
});

onMadeUp('a feed that no block programs is no 0', async (page) => {
  await ready(page);
  const reads = (wanted) => until(wanted, async () => (await text(page, 'feed')) === wanted || text(page, 'feed'));
  // A jog, or a cycle of a lathe that chooses its feed by the load.
  await page.evaluate(() => globalThis.changeMadeUp({ feed: 2, feedProgrammed: 0 }));
  await reads('120 / – mm/min');
  await page.evaluate(() => globalThis.changeMadeUp({ feed: 2, feedProgrammed: 3 }));
  await reads('120 / 180 mm/min');
});
