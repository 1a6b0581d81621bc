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
