// Where the page's knowledge comes from: the server, or for development a machine that is made up.
import type { Answer, Command } from '../lib/model';
import type { Incoming } from './incoming';

export interface Source {
  start(handle: (message: Incoming) => void): void;
  /** Resolves with the core's answer; a command whose connection was lost resolves as rejected and is never sent again. */
  send(command: Command): Promise<Answer>;
  /** Without an answer: what is repeated while a jog button is held. */
  keep(): void;
  takeLease(force: boolean): void;
  releaseLease(): void;
  /** `progress` gets ratios from 0 to 1. */
  upload(file: File, progress: (ratio: number) => void): Promise<Answer>;
}
