// What happened, as this page saw it: alarms, states, jobs, rejections, the connection. It survives a reload in this browser.
import type { Texts } from '../texts/en';
import type { EventEntry, Status } from './model';

/** Alarms and warnings are counted by themselves: however much else happens, they stay. */
const [MAX_EVENTS, MAX_ALARMS] = [500, 200];

/** The newest entries, in the order in which they came: a clock that was set back makes none of them old. */
export function newestEvents(events: EventEntry[]): EventEntry[] {
  const counts = { alarms: 0, others: 0 };
  const isKept = ({ kind }: EventEntry): boolean =>
    kind === 'alarm' || kind === 'warning' ? (counts.alarms += 1) <= MAX_ALARMS : (counts.others += 1) <= MAX_EVENTS;
  return events.toReversed().filter(isKept).toReversed();
}

/** Of events that came in this order the one to show first is the newest by its time. */
export function byTime(events: EventEntry[]): EventEntry[] {
  return events.toReversed().sort((a, b) => b.at - a.at);
}

/** The entries that the change from one status to the next is worth. */
export function changes(texts: Texts, before: Status | null, now: Status): Omit<EventEntry, 'id' | 'at'>[] {
  const entries: Omit<EventEntry, 'id' | 'at'>[] = [];
  const state = (text: string): void => void entries.push({ kind: 'state', number: null, text, cure: null });
  const fresh = now.alarms.filter((number) => !before?.alarms.includes(number));
  fresh.forEach((number) => {
    // The status has the sentence of the first of its alarms; of the others what their number means.
    const known: readonly [string, string] | undefined = (texts.alarmTexts as Record<number, readonly [string, string]>)[number];
    const sentence = number === now.alarms[0] ? now.alarmText : '';
    entries.push({ kind: 'alarm', number, text: sentence || known?.[0] || texts.alarms.unknown, cure: known?.[1] ?? null });
  });
  if (before === null) return entries;
  if (before.alarms.length > 0 && now.alarms.length === 0) state(texts.events.cleared);
  if (before.machineState !== now.machineState) state(now.machineState === 'on' ? texts.events.on : texts.state[now.machineState]);
  if (before.activity !== now.activity && now.activity !== 'none' && now.activity !== 'jog') {
    state(now.activity === 'program' ? texts.events.started(now.program.replace(/^.*\//, '')) : texts.activity[now.activity]);
  }
  if (before.activity !== 'none' && before.activity !== 'jog' && now.activity === 'none') {
    state(texts.events.ended[now.jobResult]);
  }
  // The core has none at the start of a job: the same text in another job is another message.
  if (now.message !== '' && (now.message !== before.message || now.job !== before.job)) entries.push({ kind: 'message', number: null, text: now.message, cure: null });
  if (before.program !== now.program && now.program !== '') state(texts.events.loaded(now.program.replace(/^.*\//, '')));
  return entries;
}
