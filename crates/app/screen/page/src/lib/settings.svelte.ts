// What this browser remembers of the operator's choices. Nothing of the machine is kept here.
import type { EventEntry } from './model';
import { de } from '../texts/de';
import { en, type Texts } from '../texts/en';

export type Language = 'en' | 'de';
export type Theme = 'light' | 'dark';

const languages: Record<Language, Texts> = { en, de };

function stored(key: string): string | null {
  try {
    return localStorage.getItem(`evolvent.${key}`);
  } catch {
    return null; // storage may be forbidden; the page works without it
  }
}

function store(key: string, value: string): void {
  try {
    localStorage.setItem(`evolvent.${key}`, value);
  } catch {
    // as above
  }
}

function initialLanguage(): Language {
  const kept = stored('language');
  if (kept === 'en' || kept === 'de') return kept;
  return navigator.language.toLowerCase().startsWith('de') ? 'de' : 'en';
}

function initialTheme(): Theme {
  const kept = stored('theme');
  if (kept === 'light' || kept === 'dark') return kept;
  return matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light';
}

class Settings {
  language = $state<Language>(initialLanguage());
  theme = $state<Theme>(initialTheme());

  get texts(): Texts {
    return languages[this.language];
  }

  setLanguage(language: Language): void {
    this.language = language;
    store('language', language);
  }

  setTheme(theme: Theme): void {
    this.theme = theme;
    store('theme', theme);
  }

  list(key: string): string[] {
    try {
      const value: unknown = JSON.parse(stored(key) ?? '[]');
      return Array.isArray(value) ? value.filter((entry): entry is string => typeof entry === 'string') : [];
    } catch {
      return [];
    }
  }

  /** What `keep` kept of the journal; nothing where somebody else wrote there. */
  entries(key: string): EventEntry[] {
    try {
      const value: unknown = JSON.parse(stored(key) ?? '[]');
      if (!Array.isArray(value)) return [];
      return (value as Partial<EventEntry>[]).filter(
        (entry): entry is EventEntry => typeof entry?.id === 'number' && typeof entry.at === 'number' && typeof entry.text === 'string',
      );
    } catch {
      return [];
    }
  }

  /** What `keep` kept; null where it is nothing that can be read. */
  kept(key: string): unknown {
    try {
      return JSON.parse(stored(key) ?? 'null');
    } catch {
      return null;
    }
  }

  keep(key: string, value: unknown): void {
    store(key, JSON.stringify(value));
  }
}

export const settings = new Settings();
