// Runs the blocks of a macro one after the other: each when the one before it is done.
import { answerSaid } from './alarms';
import type { Macro, Status } from './model';
import { session } from './session.svelte';
import { settings } from './settings.svelte';

/** How often the end of a block is looked for, ms. */
const LOOK_MS = 30;

class MacroRun {
  /** what runs, and the block it has come to, from 1 */
  running = $state<{ name: string; block: number; blocks: number } | null>(null);
  failed = $state('');

  /** Whether a macro may begin now. */
  get may(): boolean {
    const status = session.status;
    return this.running === null && session.mayCommand && status?.machineState === 'on' && status.activity === 'none';
  }

  async run(macro: Macro): Promise<void> {
    if (!this.may) return;
    this.failed = '';
    for (const [i, block] of macro.blocks.entries()) {
      this.running = { name: macro.name, block: i + 1, blocks: macro.blocks.length };
      const problem = await this.#block(block);
      if (problem === null) continue;
      this.failed = settings.texts.macros.failed(macro.name, i + 1, problem);
      break;
    }
    this.running = null;
  }

  /** Runs a block and waits for its end; why the macro must not go on, or null. */
  async #block(block: string): Promise<string | null> {
    const t = settings.texts.macros;
    const before = session.status?.job ?? 0;
    if (!session.mayCommand) return t.noControl;
    if (!(await session.inMode('mdi', { name: 'mdi', block }))) {
      const { rejection } = session;
      return rejection ? answerSaid(settings.texts, rejection) : t.noControl;
    }
    for (;;) {
      await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
      // Whoever has lost control or connection goes on with nothing.
      if (!session.mayCommand) return t.noControl;
      const status: Status | null = session.status;
      if (status === null || status.job <= before || status.activity !== 'none') continue;
      return status.jobResult === 'done' ? null : settings.texts.events.ended[status.jobResult];
    }
  }
}

export const macroRun = new MacroRun();
