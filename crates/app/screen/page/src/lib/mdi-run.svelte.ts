// One block of MDI per press: from the press until the core has begun it. A block in G91 that is sent twice moves twice as far.
import type { Answer } from './model';
import { session } from './session.svelte';

/** A status shows the block's job within this time of the answer; then another press counts in any case, ms. */
const SHOWN_MS = 2000;
/** How often it is looked for, ms. */
const LOOK_MS = 20;

class MdiRun {
  /** a block is on its way: another press has no effect */
  busy = $state(false);

  /** Runs a block, unless one is on its way already. */
  async run(block: string): Promise<{ sent: boolean; rejection: Answer | null }> {
    if (this.busy) return { sent: false, rejection: null };
    this.busy = true;
    const before = session.status?.job ?? 0;
    const accepted = await session.inMode('mdi', { name: 'mdi', block });
    if (!accepted) {
      this.busy = false;
      return { sent: true, rejection: session.rejection };
    }
    void this.#settle(before);
    return { sent: true, rejection: null };
  }

  async #settle(before: number): Promise<void> {
    const end = performance.now() + SHOWN_MS;
    while (session.status?.job === before && performance.now() < end) await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    this.busy = false;
  }
}

export const mdiRun = new MdiRun();
