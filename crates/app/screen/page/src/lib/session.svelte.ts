// The one place where the page keeps what it has been told, and from which commands go out.
import type { SignalValues } from '../generated/SignalValues';
import type { Incoming, LinkLoss, Sample } from '../link/incoming';
import type { Source } from '../link/source';
import { WORK_SYSTEMS } from './model';
import type { Answer, Command, EventEntry, Lease, Machine, Macro, ProgramInfo, Status, Tool, WorkOffset } from './model';
import { changes, newestEvents } from './journal';
import { settings } from './settings.svelte';

/** Time within which new events are kept in the browser. */
const KEEP_EVENTS_MS = 1000;
/** What needs another mode first is sent within this time of the press, or not at all. */
const MAX_PRESS_AGE_MS = 1000;
/** Without a status for this time the figures are not live: some of these looks in a row, so that a page that had no time itself does not say so. */
const LOOK_MS = 100;
const QUIET_LOOKS = 3;
/** A command that stops has its answer by then, ms. */
const CONFIRMED_MS = 500;
/** Commands that stop, whose answer is waited for. */
export type StopName = 'estop' | 'stop' | 'hold' | 'off';
const STOPS: readonly string[] = ['estop', 'stop', 'hold', 'off'] satisfies StopName[];

/** Seconds of samples that the page keeps for the scope and the trail. */
export const HISTORY_S = 60;
/** The shortest period for which the history is made that long, s. */
const MIN_PERIOD_S = 1e-4;

/** Ring of samples in typed arrays, so that 60 s at the rate of the server do not become garbage. */
export class History {
  readonly capacity: number;
  readonly axes: number;
  readonly time: Float64Array;
  readonly line: Uint32Array;
  readonly rapid: Uint8Array;
  /** 1 where samples before this one are missing: a line from the one before would be made up */
  readonly gap: Uint8Array;
  readonly feed: Float32Array;
  readonly load: Float32Array;
  readonly position: Float32Array[];
  readonly velocity: Float32Array[];
  readonly acceleration: Float32Array[];
  readonly error: Float32Array[];
  readonly actualVelocity: Float32Array[];
  readonly actualPosition: Float32Array[];
  readonly torque: Float32Array[];
  readonly phaseError: Float32Array;
  /** change of the acceleration since the setpoint before */
  readonly jerk: Float32Array[];
  /** of each spindle: commanded and measured speed, angle */
  readonly spindles: Float32Array[];
  /** inputs, then outputs */
  readonly signals: Float32Array[];
  /** work zero and tool offset that were in force: the machine's position less this is that of the tool on the work */
  readonly zero: Float32Array[];
  /** that of the status under which it came: setpoints do not tell their own */
  readonly lateness: Float32Array;
  /** samples ever written; the newest is at (count - 1) % capacity */
  count = 0;
  /** time between two setpoints, and between the last two samples, s */
  #period = NaN;
  #step = NaN;

  constructor(axes: number, capacity: number, spindles = 0, signals = 0) {
    this.axes = axes;
    this.capacity = capacity;
    const list = (length = axes): Float32Array[] => Array.from({ length }, () => new Float32Array(capacity));
    this.time = new Float64Array(capacity);
    this.line = new Uint32Array(capacity);
    this.rapid = new Uint8Array(capacity);
    this.gap = new Uint8Array(capacity);
    this.feed = new Float32Array(capacity);
    this.load = new Float32Array(capacity);
    this.lateness = new Float32Array(capacity);
    this.position = list();
    this.velocity = list();
    this.acceleration = list();
    this.error = list();
    this.zero = list();
    this.actualVelocity = list();
    this.actualPosition = list();
    this.torque = list();
    this.phaseError = new Float32Array(capacity);
    this.jerk = list();
    this.spindles = list(3 * spindles);
    this.signals = list(signals);
  }

  /** Whether it is made for a machine with so much. */
  fits(axes: number, spindles: number, signals: number): boolean {
    return this.axes === axes && this.spindles.length === 3 * spindles && this.signals.length === signals;
  }

  /** A ring of another length with the newest samples before the `end`-th, under their numbers. */
  copy(capacity: number, end = this.count): History {
    const copy = new History(this.axes, Math.max(1, capacity), this.spindles.length / 3, this.signals.length);
    const begin = Math.max(0, end - copy.capacity, this.count - this.capacity);
    const lists = (history: History): (Float64Array | Float32Array | Uint32Array | Uint8Array)[] => [
      history.time, history.line, history.rapid, history.gap, history.feed, history.load, history.lateness, history.phaseError,
      ...history.position, ...history.velocity, ...history.acceleration, ...history.error, ...history.zero,
      ...history.actualVelocity, ...history.actualPosition, ...history.torque, ...history.jerk, ...history.spindles, ...history.signals,
    ];
    const [from, to] = [lists(this), lists(copy)];
    for (let i = begin; i < end; i += 1) {
      const [source, target] = [i % this.capacity, i % copy.capacity];
      for (let list = 0; list < to.length; list += 1) to[list]![target] = from[list]![source]!;
    }
    copy.count = end;
    return copy;
  }

  push(sample: Sample, status: Status | null): void {
    const at = this.count % this.capacity;
    this.time[at] = sample.time;
    this.line[at] = sample.line;
    this.rapid[at] = sample.rapid ? 1 : 0;
    this.feed[at] = sample.feed;
    this.load[at] = sample.load ?? NaN;
    this.phaseError[at] = sample.phaseError ?? NaN;
    this.lateness[at] = (status?.latenessNs ?? 0) / 1000;
    const before = this.count > 0 ? (this.count - 1) % this.capacity : -1;
    const step = before < 0 ? NaN : sample.time - this.time[before]!;
    // The smallest so far, or two that are alike, as of a machine with another period: samples are lost in frames of several, so that two
    // gaps do not follow each other.
    if (step > 0 && (!(step > this.#period) || Math.abs(step - this.#step) < 0.1 * step)) this.#period = step;
    this.#step = step;
    // Where setpoints are missing, the jerk between is not known.
    const isNext = step > 0 && step < 1.5 * this.#period;
    this.gap[at] = isNext || before < 0 ? 0 : 1;
    this.spindles.forEach((list, i) => (list[at] = sample.spindles?.[i] ?? NaN));
    this.signals.forEach((list, i) => (list[at] = sample.signals?.[i] ?? NaN));
    for (let axis = 0; axis < this.axes; axis += 1) {
      this.position[axis]![at] = sample.position[axis] ?? NaN;
      this.velocity[axis]![at] = sample.velocity[axis] ?? NaN;
      this.acceleration[axis]![at] = sample.acceleration[axis] ?? NaN;
      this.error[axis]![at] = sample.error?.[axis] ?? NaN;
      this.actualVelocity[axis]![at] = sample.actualVelocity?.[axis] ?? NaN;
      this.actualPosition[axis]![at] = sample.actualPosition?.[axis] ?? NaN;
      this.torque[axis]![at] = sample.torque?.[axis] ?? NaN;
      this.jerk[axis]![at] = isNext ? (this.acceleration[axis]![at]! - this.acceleration[axis]![before]!) / step : NaN;
      this.zero[axis]![at] = (status?.workOffset[axis] ?? 0) + (status?.toolOffset[axis] ?? 0);
    }
    this.count += 1;
  }
}

/** Whether a program's file is the one of a status, which truncates long names (128 bytes) at a boundary of a character. */
function isFileOf(program: ProgramInfo | null, loaded: string): boolean {
  if (program === null) return false;
  return program.file === loaded || (program.file.startsWith(loaded) && new TextEncoder().encode(loaded).length + 4 > 128);
}

class Session {
  connection = $state<'connecting' | 'open' | 'lost' | 'refused'>('connecting');
  /** why there is no connection */
  loss = $state<LinkLoss | null>(null);
  coreAlive = $state(false);
  machine = $state.raw<Machine | null>(null);
  status = $state.raw<Status | null>(null);
  lease = $state.raw<Lease>({ mine: false, holder: null, readOnly: false });
  events = $state.raw<EventEntry[]>(settings.entries('events'));
  program = $state.raw<ProgramInfo | null>(null);
  /** a program is on its way from this page: what is loaded is not what was wanted last */
  isUploading = $state(false);
  offsets = $state.raw<WorkOffset[]>([]);
  /** of the work offset in force, degrees */
  readonly rotation = $derived(this.offsets.find((entry) => WORK_SYSTEMS[entry.system - 1] === this.status?.workSystem)?.rotation ?? 0);
  tools = $state.raw<Tool[]>([]);
  macros = $state.raw<Macro[]>([]);
  /** null before the first, and on a machine without signals */
  signals = $state.raw<SignalValues | null>(null);
  /** what is wrong with the file of macros */
  macrosProblem = $state<string | null>(null);
  /** The latest rejection, shown until the next command. */
  rejection = $state.raw<Answer | null>(null);
  history: History | null = null;
  /** s since the last status; 0 while they come */
  quietS = $state(0);
  /** a command that stops had no answer in time, and the machine has not shown its effect */
  unconfirmed = $state<StopName | null>(null);

  #source: Source | null = null;
  #pending: Status | null = null;
  /** the server keeps a log of alarms, commands and messages */
  #serverLogs = false;
  /** the newest status, drawn or not */
  #seen: Status | null = null;
  #frame = 0;
  /** period of the samples for which the history was made, s; 0 before it is known */
  #periodS = 0;
  #heardAt = 0;
  #quietLooks = 0;
  /** timer of the events that are not yet kept */
  #keeping = 0;

  get connected(): boolean {
    return this.connection === 'open';
  }

  /** Whether a command from this page has a chance: the controls are off otherwise. */
  get mayCommand(): boolean {
    return this.connected && this.coreAlive && this.lease.mine && !this.lease.readOnly;
  }

  /** Whether this page may stop the machine: every page may, unless it can only watch. */
  get mayStop(): boolean {
    return !this.lease.readOnly;
  }

  /** The core has loaded a program, and it is not the one that is shown. */
  get isOtherProgram(): boolean {
    const loaded = this.status?.program ?? '';
    return loaded !== '' && !isFileOf(this.program, loaded);
  }

  /** The file that Start and Step name: the program that is loaded, where it is the one that is shown. A text that nobody sees is not started. */
  get startable(): string | null {
    const { program, status } = this;
    if (program === null || program.problem !== null || !status?.program || this.isOtherProgram || this.isUploading) return null;
    return program.file;
  }

  /** The message of the job that runs: the core clears it when a job begins. */
  get message(): string {
    const status = this.status;
    return status === null || status.activity === 'none' ? '' : status.message;
  }

  start(source: Source): void {
    this.#source = source;
    window.addEventListener('pagehide', () => {
      if (this.#keeping !== 0) this.#keepEvents();
    });
    source.start((message) => this.#take(message));
    window.setInterval(() => this.#look(), LOOK_MS);
  }

  get source(): Source | null {
    return this.#source;
  }

  async send(command: Command): Promise<Answer> {
    const source = this.#source;
    if (source === null) return { accepted: false, alarm: 0, text: settings.texts.link.lost };
    const watched = STOPS.includes(command.name) ? (command.name as StopName) : null;
    const timer = watched && window.setTimeout(() => (this.unconfirmed = watched), CONFIRMED_MS);
    const answer = await source.send(command);
    if (watched !== null && timer !== null) {
      clearTimeout(timer);
      // Whatever the core says, it has heard it; refusals of the server itself have no number.
      this.unconfirmed = answer.accepted || (answer.alarm !== 0 && !answer.isUnknown) ? null : watched;
    }
    // A jog that is kept alive must not wipe away what an operator still reads.
    if (command.name !== 'jog_keep') this.rejection = answer.accepted ? null : answer;
    if (!answer.accepted && !this.#serverLogs) this.note({ kind: 'warning', number: answer.alarm || null, text: `${command.name}: ${answer.text}`, cure: null });
    return answer;
  }

  note(entry: Omit<EventEntry, 'id' | 'at'>): void {
    this.#addEvents([{ ...entry, at: Date.now() }]);
  }

  #addEvents(entries: Omit<EventEntry, 'id'>[]): void {
    let id = this.events.reduce((highest, entry) => Math.max(highest, entry.id), 0);
    this.events = newestEvents([...this.events, ...entries.map((entry) => ({ ...entry, id: (id += 1) }))]);
    // Writing them all takes a while, and entries come in bursts.
    if (this.#keeping === 0) this.#keeping = window.setTimeout(() => this.#keepEvents(), KEEP_EVENTS_MS);
  }

  #keepEvents(): void {
    clearTimeout(this.#keeping);
    this.#keeping = 0;
    settings.keep('events', this.events);
  }

  /** Entries of the server's log among our own, by their times; it sends those that it keeps on every connection. */
  #merge(entries: Omit<EventEntry, 'id'>[]): void {
    const known = new Set(this.events.map((entry) => `${entry.at} ${entry.kind} ${entry.text}`));
    const fresh = entries
      .filter((entry) => !known.has(`${entry.at} ${entry.kind} ${entry.text}`))
      .map(({ at, kind, number, text, fact, cure }) => ({ at, kind, number, text, fact: fact ?? null, cure }));
    if (fresh.length > 0) this.#addEvents(fresh);
  }

  forget(): void {
    this.events = [];
    this.#keepEvents();
  }

  /** Sends several one after the other, and stops at the first that is rejected. */
  async sendAll(commands: Command[]): Promise<boolean> {
    for (const command of commands) {
      const answer = await this.send(command);
      if (!answer.accepted) return false;
    }
    return true;
  }

  /** Confirms that the tool for which the machine waits is in the spindle, and continues; `tool` is what the operator was told to put there. */
  async confirmTool(tool: number): Promise<boolean> {
    // The newest status, drawn or not: a press is for the tool that was seen.
    const now = this.#seen;
    if (now?.toolChange === 'operator' && now.toolWanted === tool) return this.sendAll([{ name: 'resume' }]);
    const text = settings.texts.actions.notWanted(tool, now?.toolChange === 'operator' ? now.toolWanted : null);
    this.rejection = { accepted: false, alarm: 0, text };
    return false;
  }

  /** Commands that belong to a mode change it first, as `evolvent ctl` does. */
  async inMode(mode: Status['mode'], command: Command): Promise<boolean> {
    if (this.status?.mode === mode) return this.sendAll([command]);
    const pressed = performance.now();
    if (!(await this.sendAll([{ name: 'mode', mode }]))) return false;
    // Who pressed has looked elsewhere by now.
    if (performance.now() - pressed > MAX_PRESS_AGE_MS) {
      this.rejection = { accepted: false, alarm: 0, text: settings.texts.link.late };
      return false;
    }
    return this.sendAll([command]);
  }

  #take(message: Incoming): void {
    switch (message.kind) {
      case 'connection':
        if (message.state !== this.connection) {
          const events = settings.texts.events;
          if (message.state === 'open') this.note({ kind: 'link', number: null, text: events.connected, cure: null });
          else if (this.connection === 'open') this.note({ kind: 'link', number: null, text: events.disconnected, cure: null });
        }
        this.connection = message.state;
        this.loss = message.loss;
        if (message.state !== 'open') {
          this.lease = { ...this.lease, mine: false };
        }
        break;
      case 'core':
        this.coreAlive = message.alive;
        break;
      case 'machine':
        {
          const { axes, spindles, inputs, outputs } = message.machine;
          const signals = inputs.length + outputs.length;
          if (this.history === null || !this.history.fits(axes.length, spindles.length, signals)) {
            // Until the samples tell their period.
            this.history = new History(axes.length, HISTORY_S * 1000, spindles.length, signals);
            this.#periodS = 0;
          }
        }
        this.machine = message.machine;
        break;
      case 'status':
        for (const entry of changes(settings.texts, this.#seen, message.status)) {
          // What the server logs, too, is listed once.
          if (!this.#serverLogs || entry.kind === 'state') this.note(entry);
        }
        this.#seen = message.status;
        this.#heardAt = performance.now();
        this.#quietLooks = 0;
        if (this.quietS !== 0) this.quietS = 0;
        if (this.unconfirmed !== null) this.#confirm(message.status);
        // Of several that come within a frame only the last is drawn.
        this.#pending = message.status;
        if (this.#frame === 0) {
          this.#frame = requestAnimationFrame(() => this.#draw());
        }
        if (document.hidden) this.#draw();
        break;
      case 'lease':
        if (this.lease.mine && !message.lease.mine && message.lease.holder !== null) {
          const text = settings.texts.lease.lost(message.lease.holder);
          this.note({ kind: 'warning', number: null, text, cure: null });
          this.rejection = { accepted: false, alarm: 0, text };
        }
        this.lease = message.lease;
        break;
      case 'program':
        this.program = message.program;
        break;
      case 'offsets':
        this.offsets = message.offsets;
        break;
      case 'tools':
        this.tools = message.tools;
        break;
      case 'macros':
        [this.macros, this.macrosProblem] = [message.macros, message.problem];
        break;
      case 'signals':
        this.signals = message.signals;
        break;
      case 'log':
        this.#serverLogs = true;
        this.#merge(message.entries);
        break;
      case 'samples':
        this.#fit(message.samples);
        // Drawn or not: a status comes before the samples that were taken under it.
        for (const sample of message.samples) this.history?.push(sample, this.#seen);
        break;
    }
  }

  /** Makes the history as long as its time at the period of the samples, of which there may be several in a millisecond. */
  #fit(samples: Sample[]): void {
    if (this.history === null) return;
    let period = Infinity;
    for (let i = 1; i < samples.length; i += 1) {
      const step = samples[i]!.time - samples[i - 1]!.time;
      if (step > MIN_PERIOD_S / 2) period = Math.min(period, step);
    }
    // Rounded times, and gaps where samples were lost, are no other period.
    if (!Number.isFinite(period) || (this.#periodS > 0 && period > 0.9 * this.#periodS)) return;
    this.#periodS = period;
    const capacity = Math.ceil(HISTORY_S / Math.max(MIN_PERIOD_S, period)) + 1;
    if (capacity !== this.history.capacity) this.history = this.history.copy(capacity);
  }

  /** Whether statuses still come. */
  #look(): void {
    this.#quietLooks += 1;
    const isQuiet = this.status !== null && this.#quietLooks > QUIET_LOOKS;
    const seconds = isQuiet ? Math.max(1, Math.floor((performance.now() - this.#heardAt) / 1000)) : 0;
    if (seconds !== this.quietS) this.quietS = seconds;
  }

  /** What a stop without an answer was to do is seen. */
  #confirm(status: Status): void {
    const name = this.unconfirmed;
    const rests = status.activity === 'none';
    if (
      (name === 'estop' && status.machineState === 'estop') ||
      (name === 'off' && status.machineState !== 'on') ||
      (name === 'stop' && rests) ||
      (name === 'hold' && (rests || status.hold))
    )
      this.unconfirmed = null;
  }

  #draw(): void {
    cancelAnimationFrame(this.#frame);
    this.#frame = 0;
    if (this.#pending !== null) this.status = this.#pending;
    this.#pending = null;
  }
}

export const session = new Session();
