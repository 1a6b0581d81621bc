// The stock of each program, as the operator has told it: a box in work coordinates, kept by this browser.
import { settings } from '../lib/settings.svelte';
import type { Box } from './view';

/** Programs whose stock is remembered. */
const MAX_PROGRAMS = 50;

class Stock {
  #boxes = $state.raw<[string, Box][]>(stored());

  of(program: string): Box | null {
    return this.#boxes.find(([name]) => name === program)?.[1] ?? null;
  }

  set(program: string, box: Box | null): void {
    const others = this.#boxes.filter(([name]) => name !== program);
    this.#boxes = (box === null ? others : [...others, [program, box] as [string, Box]]).slice(-MAX_PROGRAMS);
    settings.keep('stock', this.#boxes);
  }
}

function isBox(value: unknown): value is Box {
  const box = value as Partial<Box> | null;
  return [box?.min, box?.max].every((corner) => Array.isArray(corner) && corner.length === 3 && corner.every(Number.isFinite));
}

function stored(): [string, Box][] {
  const value = settings.kept('stock');
  if (!Array.isArray(value)) return [];
  return value.filter((entry): entry is [string, Box] => Array.isArray(entry) && typeof entry[0] === 'string' && isBox(entry[1]));
}

export const stock = new Stock();
