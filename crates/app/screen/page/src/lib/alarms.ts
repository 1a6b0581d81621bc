import type { Answer, EventEntry } from './model';
import type { Texts } from '../texts/en';

export interface AlarmText {
  meaning: string;
  cure: string;
}

/** What an alarm means and what to do; numbers are those of docs/contract.md. */
export function explain(texts: Texts, number: number): AlarmText {
  const list: Record<number, readonly [string, string]> = texts.alarmTexts;
  const [meaning, cure] = list[number] ?? [texts.alarms.unknown, texts.alarms.unknownCure];
  return { meaning, cure };
}

/** An answer that rejects a command, in the page's language where that is known. */
export function answerSaid(texts: Texts, { alarm, text, refusal }: Answer): string {
  return refusal && texts.refusalTexts !== null ? texts.refusalTexts[refusal] : serverSaid(texts, alarm, text);
}

/** What happened, in the page's language where that is known. */
export function eventSaid(texts: Texts, { kind, number, text, fact }: EventEntry): string {
  if (fact && texts.logTexts !== null) {
    const reason = 'reason' in fact ? answerSaid(texts, { accepted: false, alarm: number ?? 0, text: fact.reason, refusal: fact.refusal }) : '';
    return texts.logTexts(fact, reason);
  }
  return kind === 'alarm' || kind === 'warning' ? serverSaid(texts, number ?? 0, text) : text;
}

/** What to do about an alarm: in the page's language where it has a text of that number. */
export function cureSaid(texts: Texts, number: number, cure: string | null): string {
  const isKnown = number in texts.alarmTexts;
  return cure === null || (isKnown && texts.rejectionTexts !== null) ? explain(texts, number).cure : cure;
}

/** A sentence of the server. Where the page is in another language, what its number means comes first: the sentence has the details. */
export function serverSaid(texts: Texts, number: number, sentence: string): string {
  if (texts.rejectionTexts === null || sentence === '') return sentence;
  const alarms: Record<number, readonly [string, string]> = texts.alarmTexts;
  const rejections: Record<number, string> = texts.rejectionTexts;
  const meaning = rejections[number] ?? alarms[number]?.[0];
  return meaning === undefined ? sentence : `${meaning} (${texts.alarms.original} ${sentence})`;
}
