// X of a lathe as the program writes it: a diameter in G7, a radius in G8. The core's figures are those of the axis, which are radii.
import type { Axis, Machine, Status } from './model';

export interface ShownAxis {
  /** beside the letter: what the figure is; empty where it is what the axis moves */
  mark: '' | '⌀' | 'R';
  /** what is shown per mm or degree of the axis */
  factor: 1 | 2;
}

export function shownAs(machine: Machine | null, status: Status | null, axis: Axis | undefined): ShownAxis {
  if (machine?.kind !== 'lathe' || axis?.letter !== 'X') return { mark: '', factor: 1 };
  return status?.modal.includes('G7') ? { mark: '⌀', factor: 2 } : { mark: 'R', factor: 1 };
}

/** The name of an axis at the head of a column. */
export function headOf(axis: Axis, { mark }: ShownAxis): string {
  return mark === '' ? axis.letter : `${axis.letter} ${mark}`;
}
