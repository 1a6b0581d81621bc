// The server that the page came from: what it says becomes the words of `model`.
import type { Finding as ServerFinding } from '../generated/Finding';
import type { ProgramInfo as ServerProgram } from '../generated/ProgramInfo';
import type { ScreenStatus } from '../generated/ScreenStatus';
import type { ToPage } from '../generated/ToPage';
import type { Answer, Command, Finding, Lease, Machine, Status } from '../lib/model';
import { programText } from '../lib/program-text.svelte';
import { settings } from '../lib/settings.svelte';
import { path } from '../path/store.svelte';
import { AXES, codeName, encode, systemName } from './commands';
import type { Incoming, LinkLoss, Sample } from './incoming';
import { Socket } from './socket';
import type { Source } from './source';

const SWITCH = { singleStep: 1, optionalStop: 2, blockDelete: 4, hold: 8, chainOpen: 16, inputWait: 32, toolUnknown: 256 } as const;
/** Bit of a setpoint's flags: a rapid. */
const RAPID = 8;
/** A page in control that the server does not hear for 3 s loses it. */
const ALIVE_MS = 500;
/**
 * A sample: time f64, line u32, flags u32, feed f64, then position, velocity, acceleration and following error of nine axes, the
 * load, measured velocity, actual position and torque of nine axes, the phase error, three figures of each spindle, and inputs and outputs, f32.
 */
const [FIRST_VALUE, FIRST_OF_SPINDLES] = [24, 65];

function finding({ line, column, length, code, message, help, file }: ServerFinding): Finding {
  return { line, column, length, code, message, help, file: file ?? null };
}

export class Server implements Source {
  #handle: (message: Incoming) => void = () => {};
  #socket: Socket | null = null;
  #machine: Machine | null = null;
  #pending = new Map<number, (answer: Answer) => void>();
  #next = 1;
  /** number of this page on its connection */
  #page = 0;
  #program: ServerProgram | null = null;
  /** offsets and tools, to notice their changes */
  #kept = '';
  /** `time_ns` of the newest status */
  #seen = 0;
  #saidAlive = 0;
  /** bits of the machine's axes, in its order */
  #bits: number[] = [];
  #sampleBytes = Infinity;

  start(handle: (message: Incoming) => void): void {
    this.#handle = handle;
    const url = new URL('ws', location.href);
    url.protocol = url.protocol.replace('http', 'ws');
    this.#socket = new Socket(url.href, {
      opened: () => {},
      text: (text) => this.#take(JSON.parse(text) as ToPage),
      binary: (buffer) => this.#samples(buffer),
      lost: (loss, final) => this.#lost(loss, final),
    });
    this.#socket.open();
  }

  send(command: Command): Promise<Answer> {
    const nothing = (text: string): Answer => ({ isUnknown: true, accepted: false, alarm: 0, text });
    if (this.#machine === null || this.#socket === null) return Promise.resolve(nothing(settings.texts.link.lost));
    const id = this.#next;
    this.#next += 1;
    return new Promise((resolve) => {
      this.#pending.set(id, resolve);
      if (this.#socket!.send(JSON.stringify({ type: 'command', id, seen_ns: this.#seen, ...encode(this.#machine!, command) }))) return;
      this.#pending.delete(id);
      resolve(nothing(settings.texts.link.lost));
    });
  }

  keep(): void {
    this.#socket?.send('{"type":"keep"}');
  }

  takeLease(force: boolean): void {
    this.#socket?.send(JSON.stringify({ type: 'take', force }));
  }

  releaseLease(): void {
    this.#socket?.send('{"type":"give"}');
  }

  upload(file: File, progress: (ratio: number) => void): Promise<Answer> {
    // `fetch` tells nothing of how much has gone out.
    return new Promise((resolve) => {
      const request = new XMLHttpRequest();
      request.open('PUT', `programs/${encodeURIComponent(file.name)}`);
      request.setRequestHeader('Evolvent-Page', String(this.#page));
      request.upload.onprogress = (event) => progress(event.total > 0 ? event.loaded / event.total : 0);
      request.onload = () => {
        try {
          resolve(JSON.parse(request.responseText) as Answer);
        } catch {
          resolve({ accepted: false, alarm: 0, text: `${request.status} ${request.statusText}` });
        }
      };
      request.onerror = () => resolve({ accepted: false, alarm: 0, text: settings.texts.link.lost });
      request.send(file);
    });
  }

  #lost(loss: LinkLoss, final: boolean): void {
    const text = settings.texts.link.unknown;
    for (const resolve of this.#pending.values()) resolve({ isUnknown: true, accepted: false, alarm: 0, text });
    this.#pending.clear();
    this.#handle({ kind: 'connection', state: final ? 'refused' : 'lost', loss });
  }

  #take(message: ToPage): void {
    switch (message.type) {
      case 'machine': {
        const { axes, has_chatter: hasChatter, sample_bytes: sampleBytes, ...rest } = message.machine;
        this.#sampleBytes = sampleBytes;
        this.#bits = axes.map((axis) => AXES.indexOf(axis.letter));
        this.#machine = {
          ...rest,
          hasChatter,
          axes: axes.map(({ max_velocity: maxVelocity, is_unlimited: isUnlimited, has_home_switch: hasHomeSwitch, ...axis }) => ({
            ...axis,
            maxVelocity,
            isUnlimited,
            hasHomeSwitch,
          })),
          periodNs: 0,
          version: message.version,
        };
        this.#handle({ kind: 'machine', machine: this.#machine });
        this.#handle({ kind: 'connection', state: 'open', loss: null });
        break;
      }
      case 'status':
        this.#seen = message.status.time_ns;
        this.#alive();
        this.#handle({ kind: 'core', alive: true });
        this.#handle({ kind: 'status', status: this.#status(message.status) });
        break;
      case 'signals': {
        const { type: _type, ...signals } = message;
        this.#handle({ kind: 'signals', signals });
        break;
      }
      case 'core':
        this.#alive();
        this.#handle({ kind: 'core', alive: message.alive });
        break;
      case 'lease': {
        this.#page = message.page;
        const lease: Lease = { mine: message.mine, holder: message.holder, readOnly: message.read_only };
        this.#handle({ kind: 'lease', lease });
        break;
      }
      case 'program': {
        const program = message.program;
        // Another upload of the same name is another text.
        programText.load(program === null || program.problem !== null ? '' : `programs/${encodeURIComponent(program.name)}?${program.upload}`);
        this.#program = program;
        this.#path();
        this.#handle({
          kind: 'program',
          program: program && {
            name: program.name,
            upload: program.upload,
            file: program.file,
            problem: program.problem,
            bytes: program.bytes,
            lines: 0,
            errors: program.errors.map(finding),
            warnings: program.warnings.map(finding),
            checked: program.checked,
            plannedS: program.planned_s,
          },
        });
        break;
      }
      case 'kept':
        this.#handle({ kind: 'offsets', offsets: message.offsets.map(({ rotation_deg: rotation, ...offset }) => ({ ...offset, rotation })) });
        this.#handle({ kind: 'tools', tools: message.tools.map(({ angles_deg: angles, ...tool }) => ({ ...tool, angles })) });
        this.#kept = JSON.stringify([message.offsets, message.tools]);
        this.#path();
        break;
      case 'macros':
        this.#handle({ kind: 'macros', macros: message.macros, problem: message.problem });
        break;
      case 'end':
        this.#socket?.end(message.what);
        break;
      case 'log':
        this.#handle({ kind: 'log', entries: message.entries });
        break;
      case 'answer': {
        const { id, accepted, alarm, text, refusal } = message;
        this.#pending.get(id)?.({ accepted, alarm, text, refusal });
        this.#pending.delete(id);
        break;
      }
    }
  }

  /** What the server sends arrives: as an answer to it, because the timers of a page that is hidden stand. */
  #alive(): void {
    const now = performance.now();
    if (now - this.#saidAlive < ALIVE_MS) return;
    this.#saidAlive = now;
    this.#socket?.send('{"type":"alive"}');
  }

  /** Offsets and tools change where the path is: it is read again with them. It comes while the program is still being checked. */
  #path(): void {
    const program = this.#program;
    if (program === null || program.problem !== null) path.load('', '');
    else if (this.#kept !== '') {
      path.load(`path/${encodeURIComponent(program.name)}?${program.upload}`, `${program.name}/${program.upload}/${this.#kept}`);
    }
  }

  #status(status: ScreenStatus): Status {
    const of = (list: number[]): number[] => this.#bits.map((bit) => list[bit] ?? NaN);
    const on = (bit: number): boolean => (status.switches & bit) !== 0;
    // Ages above a minute are those of a bridge that never was.
    const answered = status.feedback_age_ns < 60e9;
    return {
      time: status.time_ns * 1e-9,
      machineState: status.machine_state,
      mode: status.mode,
      activity: status.activity,
      state: status.state,
      line: status.line,
      job: status.job,
      jobResult: status.job_result,
      program: status.program,
      homed: this.#bits.map((bit) => ((status.homed_mask >> bit) & 1) === 1),
      machine: of(status.position_machine),
      work: of(status.position_work),
      toGo: of(status.distance_to_go),
      velocity: of(status.velocity),
      workOffset: of(status.work_offset),
      toolOffset: of(status.tool_offset),
      actual: answered ? of(status.position_actual) : null,
      followingError: answered ? of(status.following_error) : null,
      feed: status.feed_mm_s,
      feedProgrammed: status.feed_programmed_mm_s,
      override: status.override_ratio,
      rapidOverride: status.rapid_override_ratio,
      spindleOverride: status.spindle_override_ratio,
      spindleRpm: status.spindle_rpm,
      spindles: status.spindles.map((spindle) => ({
        number: spindle.number,
        command: spindle.command_rpm,
        measured: spindle.measured_rpm,
        overrideCounts: spindle.override_counts,
      })),
      coolant: status.coolant,
      tool: status.tool,
      toolUnknown: on(SWITCH.toolUnknown),
      toolChange: status.tool_change,
      toolWanted: status.tool_wanted,
      workSystem: systemName(status.work_system),
      modal: status.modal.map(codeName),
      alarms: status.alarms,
      alarmText: status.alarm_text,
      message: status.message,
      singleStep: on(SWITCH.singleStep),
      optionalStop: on(SWITCH.optionalStop),
      blockDelete: on(SWITCH.blockDelete),
      hold: on(SWITCH.hold),
      chainOpen: on(SWITCH.chainOpen),
      inputWait: on(SWITCH.inputWait),
      pathDone: status.path_mm,
      pathToGo: status.path_to_go_mm,
      lateCycles: status.late_cycles,
      latenessNs: status.wake_lateness_ns,
      longestStopMm: status.longest_stop_mm,
      longestStopS: status.longest_stop_s,
      away: this.#bits.map((bit) => ((status.away_mask >> bit) & 1) === 1),
      awayParts: status.away_parts,
      retraceBlocks: status.retrace_blocks,
      parts: status.parts,
      programTimeS: status.program_time_s,
      programHeldS: status.program_held_s,
      handwheelAxis: status.handwheel_mask === 0 ? null : this.#bits.findIndex((bit) => ((status.handwheel_mask >> bit) & 1) === 1),
      handwheelStep: status.handwheel_step,
      handwheelEnabled: status.handwheel_enabled !== 0,
    };
  }

  #samples(buffer: ArrayBuffer): void {
    const view = new DataView(buffer);
    const samples: Sample[] = [];
    if (this.#machine === null) return;
    const [spindles, signals] = [3 * this.#machine.spindles.length, this.#machine.inputs.length + this.#machine.outputs.length];
    const bytes = this.#sampleBytes;
    for (let at = 0; at + bytes <= buffer.byteLength; at += bytes) {
      const list = (first: number): number[] => this.#bits.map((bit) => view.getFloat32(at + FIRST_VALUE + 4 * (first + bit), true));
      const row = (first: number, length: number): number[] => Array.from({ length }, (_, i) => view.getFloat32(at + FIRST_VALUE + 4 * (first + i), true));
      samples.push({
        time: view.getFloat64(at, true),
        line: view.getUint32(at + 8, true),
        rapid: (view.getUint32(at + 12, true) & RAPID) !== 0,
        feed: view.getFloat64(at + 16, true),
        position: list(0),
        velocity: list(9),
        acceleration: list(18),
        error: list(27),
        load: view.getFloat32(at + FIRST_VALUE + 4 * 36, true),
        actualVelocity: list(37),
        actualPosition: list(46),
        torque: list(55),
        phaseError: view.getFloat32(at + FIRST_VALUE + 4 * 64, true),
        spindles: row(FIRST_OF_SPINDLES, spindles),
        signals: row(FIRST_OF_SPINDLES + spindles, signals),
      });
    }
    this.#handle({ kind: 'samples', samples });
  }
}
