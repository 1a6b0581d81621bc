/** How often is looked, ms. */
const LOOK_MS = 10;

/** Measures the longest time for which this process got no processor: what a page beside it lacks, too. */
export class HostWatch {
  #longest = 0;
  #last = performance.now();
  #timer = setInterval(() => this.#look(), LOOK_MS);

  #look() {
    const now = performance.now();
    this.#longest = Math.max(this.#longest, now - this.#last - LOOK_MS);
    this.#last = now;
  }

  /** Ends it; gives the longest pause, ms. */
  end() {
    this.#look();
    clearInterval(this.#timer);
    return this.#longest;
  }
}
