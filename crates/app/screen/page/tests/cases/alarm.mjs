// Alarms, rejections and the log of events.
import assert from 'node:assert/strict';
import { at, ready, text, until, view } from '../operator.mjs';
import { anywhere, onMadeUp } from '../case.mjs';

onMadeUp('alarms outlast everything else in the log, whatever the clock says', async (page) => {
  const found = await page.evaluate(async () => {
    const { newestEvents, byTime } = await import('/src/lib/journal.ts');
    const entry = (id, kind, at) => ({ id, at, kind, number: null, text: `${kind} ${id}`, cure: null });
    // An alarm, hours of commands, then the clock is set back by an hour and an alarm comes.
    let events = [entry(1, 'alarm', 5_000_000)];
    for (let id = 2; id < 5000; id += 1) events = newestEvents([...events, entry(id, 'command', 5_000_000 + id)]);
    events = newestEvents([...events, entry(5000, 'alarm', 5_000_000 - 3_600_000)]);
    return { count: events.length, alarms: events.filter(({ kind }) => kind === 'alarm').map(({ id }) => id), last: events.at(-1).id, first: byTime(events)[0].id };
  });
  assert.deepEqual(found, { count: 502, alarms: [1, 5000], last: 5000, first: 4999 });
  // Many entries at once are written once.
  const writes = await page.evaluate(async () => {
    const { session } = await import('/src/lib/session.svelte.ts');
    let count = 0;
    const write = Storage.prototype.setItem;
    Storage.prototype.setItem = function (...words) {
      count += 1;
      write.apply(this, words);
    };
    for (let i = 0; i < 200; i += 1) session.note({ kind: 'state', number: null, text: `entry ${i}`, cure: null });
    const atOnce = count;
    await new Promise((resolve) => setTimeout(resolve, 1500));
    return { atOnce, later: count, kept: JSON.parse(localStorage.getItem('evolvent.events')).at(-1).text };
  });
  assert.deepEqual({ ...writes, later: writes.later <= 3 }, { atOnce: 0, later: true, kept: 'entry 199' });
});

onMadeUp('what the server logs is said in the language of the page', async (page) => {
  await page.evaluate(() => {
    const facts = [
      [{ code: 'accepted', command: 'START', page: 3 }, 'START by page 3'],
      [{ code: 'rejected', command: 'JOG', page: 3, reason: 'the command arrived too late and was not sent', refusal: 'too_late' }, 'JOG by page 3 was rejected: the command arrived too late and was not sent'],
      [{ code: 'rejected', command: 'ON', page: 3, reason: 'the machine is in emergency stop', refusal: null }, 'ON by page 3 was rejected: the machine is in emergency stop', 910],
      [{ code: 'loaded', program: 'a.ngc' }, 'LOAD a.ngc: accepted'],
      [{ code: 'control_taken', page: 4, from: 3 }, 'page 4 took control from page 3'],
      [{ code: 'control_expired', page: 4 }, 'page 4 has sent nothing for 3 s and has lost control'],
    ];
    const entries = facts.map(([fact, text, number = null], i) => ({ at: Date.now() + i, kind: 'command', number, text, fact, cure: null }));
    entries.push({ at: Date.now() + 99, kind: 'alarm', number: 401, text: 'the bridge is silent', fact: null, cure: 'see the bridge' });
    globalThis.tellMadeUp({ kind: 'log', entries });
  });
  await view(page, 'events');
  const lines = () => page.locator(`${at('events')} li`).evaluateAll((list) => list.map((line) => line.innerText.replace(/^[\d:]+\s*/, '').replace(/\s+/g, ' ').trim()));
  const seen = await lines();
  for (const text of ['START by page 3', 'page 4 took control from page 3', '910 ON by page 3 was rejected: the machine is in emergency stop']) assert.ok(seen.includes(text), `${text}\n${seen.join('\n')}`);
  await page.locator(at('menu')).click();
  await page.locator('dialog[open] [lang="de"]').click();
  await page.keyboard.press('Escape');
  const german = await lines();
  for (const text of [
    'START von Seite 3', 'JOG von Seite 3 abgelehnt: der Befehl kam zu spät und wurde nicht gesendet', 'Programm a.ngc geladen',
    'Seite 4 hat die Bedienung übernommen, von Seite 3', 'Seite 4 hat 3 s lang nichts gesendet und die Bedienung verloren',
    '910 ON von Seite 3 abgelehnt: Die Maschine ist im Not-Halt; zuerst zurücksetzen (im Original: the machine is in emergency stop)',
  ]) assert.ok(german.includes(text), `${text}\n${german.join('\n')}`);
  assert.ok(german.every((text) => !/ by page |took control|see the bridge/.test(text)), german.join('\n'));
});

onMadeUp('what the server refuses is said in the language of the page', async (page) => {
  await ready(page);
  const language = async (name) => {
    await page.locator(at('menu')).click();
    await page.locator(`dialog[open] [lang="${name}"]`).click();
    await page.keyboard.press('Escape');
  };
  const said = async (wanted) => {
    await page.locator('#feed_override').fill('70');
    await page.locator('#feed_override').fill('60');
    await until(`${wanted}`, async () => wanted.test(await text(page, 'advice')) || text(page, 'advice'));
  };
  await page.evaluate(() => globalThis.rejectMadeUp('the page was out of date; check the machine and press again', 'out_of_date'));
  await said(/the page was out of date/);
  await language('de');
  await said(/die Seite war nicht auf dem neuesten Stand/);
  // Pages are numbers, and named in the language.
  await page.evaluate(() => globalThis.tellMadeUp({ kind: 'lease', lease: { mine: false, holder: 3, readOnly: false } }));
  await until('Seite 3', async () => /Seite 3 hat die Bedienung übernommen/.test(await text(page, 'advice')) || text(page, 'advice'));
});

anywhere('the log of events survives a reload of the page', async (page) => {
  await page.locator(at('estop')).click();
  await ready(page);
  await view(page, 'events');
  // What only the page knows: the server's log has commands and alarms, not states.
  const own = async () => (await page.locator(`${at('events')} li.state`).allInnerTexts()).filter((line) => /Power on/.test(line));
  await until('an entry', async () => (await own()).length > 0);
  const before = await own();
  await page.reload();
  await page.locator(at('lease')).waitFor();
  await view(page, 'events');
  await until('as many', async () => (await own()).length >= before.length || own());
  assert.deepEqual((await own()).slice(-before.length), before);
});

onMadeUp('of several alarms the cause is told, in full where it is asked for, and covers nothing', async (page) => {
  await ready(page);
  const sentence = `${'no feedback for 25 ms from the bridge of the axes, '.repeat(4)}and this is its end`;
  const faults = () =>
    page.evaluate(() => {
      const bar = document.querySelector('header').getBoundingClientRect();
      const seen = (element) => {
        const box = element.getBoundingClientRect();
        return element.contains(document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2));
      };
      const shown = [...document.querySelectorAll('[role="tab"], header button:not(.away)')].filter((element) => element.offsetParent !== null && element.getBoundingClientRect().right <= innerWidth);
      return {
        covered: shown.filter((element) => !element.disabled && !seen(element)).map((element) => element.textContent.trim()),
        below: [...document.querySelectorAll('.sentences, .sentences > *')].filter((element) => element.getBoundingClientRect().bottom > bar.bottom + 1).map((element) => element.textContent),
      };
    });
  for (const language of ['en', 'de']) {
    await page.locator(at('menu')).click();
    await page.locator(`dialog[open] [lang="${language}"]`).click();
    await page.keyboard.press('Escape');
    await page.evaluate((alarmText) => globalThis.changeMadeUp({ alarms: [401, 418, 407], alarmText }), sentence);
    for (const [width, height] of [[1024, 600], [3840, 2160], [390, 844]]) {
      await page.setViewportSize({ width, height });
      const begin = language === 'en' ? /^401 \(and 2 more\): no feedback/ : /^401 \(und 2 weitere\): die Rückmeldung blieb aus \(im Original: no feedback/;
      await until('the cause', async () => begin.test(await text(page, 'cause')) || text(page, 'cause'));
      await page.waitForTimeout(100);
      assert.deepEqual(await faults(), { covered: [], below: [] }, `${language}, ${width} x ${height}`);
      if (width > 2000) continue;
      await page.locator(at('said-whole')).click();
      const end = await page.locator(at('cause')).evaluate((element) => {
        const range = document.createRange();
        range.selectNodeContents(element);
        const box = [...range.getClientRects()].at(-1);
        return element.contains(document.elementFromPoint(box.right - 4, box.top + box.height / 2));
      });
      assert.equal(end, true, `${language}: its end is seen`);
      await page.locator(at('said-whole')).click();
    }
    await page.setViewportSize({ width: 1024, height: 600 });
    await page.locator(at('alarms')).click();
    assert.equal(await page.locator(`${at('alarm-list')} li`).first().locator(at('alarm-text')).innerText(), sentence);
    await page.locator(`${at('alarm-list')} .row button`).last().click();
  }
  await page.evaluate(() => globalThis.changeMadeUp({ alarms: [], alarmText: '' }));
});

anywhere('alarms, rejections and events lead to their place in the documentation', async (page, context) => {
  await ready(page);
  const elsewhere = [];
  page.on('request', (request) => new URL(request.url()).origin !== new URL(page.url()).origin && elsewhere.push(request.url()));
  const frame = page.locator(`${at('help')} iframe`);
  const leads = async (link, number) => {
    await link.click();
    await frame.waitFor();
    assert.match(await frame.getAttribute('src'), new RegExp(`docs/light/alarms\\.html#${number}$`));
    if (context.real) {
      // The frame runs no script, not even that of a test, which looks at its page by itself.
      const own = await page.context().newPage();
      await own.goto(new URL(await frame.getAttribute('src'), page.url()).href);
      const heading = own.locator(`[id="${number}"]`);
      assert.equal(await heading.innerText(), String(number));
      const box = await heading.boundingBox();
      assert.ok(box.y >= 0 && box.y < 600, `${number} is in sight`);
      await own.locator('a[href="contract.html#alarms"]').first().click();
      await own.locator('#alarms').waitFor();
      await own.close();
    }
    await page.locator(at('help-close')).click();
    await frame.waitFor({ state: 'detached' });
  };
  if (context.real) {
    await view(page, 'mdi');
    await page.locator(at('mdi-block')).fill('G1 X0 F');
    await page.keyboard.press('Enter');
    const rejected = page.locator(`${at('rejection')} [data-alarm="923"]`);
    await rejected.waitFor();
    await leads(rejected, 923);
    await view(page, 'events');
    await leads(page.locator(`${at('events')} [data-alarm="923"]`).first(), 923);
  } else {
    await page.route('**/docs/**', (route) => route.fulfill({ body: '<p>made up', contentType: 'text/html' }));
    await page.evaluate(() => globalThis.raiseMadeUpAlarm(410));
    await page.locator(at('alarms')).click();
    await leads(page.locator(`${at('alarm-list')} [data-alarm="410"]`), 410);
    await page.locator(at('alarm-list')).getByText('Clear alarms').click();
    await view(page, 'events');
    await leads(page.locator(`${at('events')} [data-alarm="410"]`).first(), 410);
  }
  assert.deepEqual(elsewhere, []);
});
