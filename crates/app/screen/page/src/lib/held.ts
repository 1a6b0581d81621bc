// A program or a block of MDI that is held: the axes can leave it, by jogs or backwards along the path.
import type { Status } from './model';

/** A program or a block of MDI has the axes. */
export function isOfProgram(status: Status | null): status is Status {
  return status?.activity === 'program' || status?.activity === 'mdi';
}

/** It is held or at a program stop, whether or not the axes are away from it. */
export function isHeldProgram(status: Status | null): status is Status {
  return isOfProgram(status) && (status.state === 'held' || status.state === 'program_stop');
}

/** Jogs, RETURN or RETRACE move the axes of a held program. */
export function excursionMoves(status: Status | null): boolean {
  return isHeldProgram(status) && status.velocity.some((velocity) => velocity !== 0);
}
