// "What to do next": one sentence that the state of the machine calls for. The core judges every command by itself; this only
// says beforehand what it would answer.
import type { Texts } from '../texts/en';
import type { LinkLoss } from '../link/incoming';
import { excursionMoves } from './held';
import type { Machine, ProgramInfo, Status } from './model';

export interface Advice {
  text: string;
  tone: 'calm' | 'ask' | 'bad';
  /** the same in a word or two */
  word: string;
  /** of the machine: what only a program lacks is none of its */
  wordTone: 'calm' | 'ask' | 'bad';
}

/** What `word` and `text` say of it must be from the same moment: one function makes both. */
type Said = Pick<Advice, 'text' | 'tone'>;

export interface AdviceInputs {
  connected: boolean;
  loss: LinkLoss | null;
  coreAlive: boolean;
  machine: Machine | null;
  status: Status | null;
  program: ProgramInfo | null;
  /** it is not the one that is loaded */
  isOtherProgram: boolean;
  /** of the program that runs */
  message: string;
}

export function advise(texts: Texts, inputs: AdviceInputs): Advice {
  const { status } = inputs;
  const said = sentence(texts, inputs);
  const isKnown = inputs.connected && inputs.coreAlive && status !== null && inputs.machine !== null;
  const word = isKnown ? wordOf(texts, status) : texts.state.unknown;
  const isReady = isKnown && status.machineState === 'on' && status.activity === 'none' && status.alarms.length === 0;
  return { ...said, word, wordTone: isReady && said.tone === 'bad' ? 'calm' : said.tone };
}

/** The program or block has begun, or is over, while nothing of it moves. */
function isBetween(status: Status): boolean {
  return ['idle', 'done', 'stopped', 'fault'].includes(status.state);
}

function wordOf(texts: Texts, status: Status): string {
  if (status.machineState !== 'on') return texts.state[status.machineState];
  if (status.activity === 'none') return texts.state.ready;
  if (status.state === 'running' || status.state === 'dwell') return texts.activity[status.activity];
  // A job that still has the axes is not ready.
  return isBetween(status) ? texts.activity[status.activity] : texts.runState[status.state];
}

function sentence(texts: Texts, { connected, loss, coreAlive, machine, status, program, isOtherProgram, message }: AdviceInputs): Said {
  const a = texts.advice;
  if (!connected) return { text: a.noServer[loss ?? 'closed'], tone: 'bad' };
  if (!coreAlive || status === null || machine === null) return { text: a.noCore, tone: 'bad' };
  if (status.chainOpen) return { text: a.chainOpen, tone: 'bad' };
  // A fault switches off and latches its alarm; leaving the emergency stop comes first either way.
  if (status.machineState === 'estop') return { text: a.estop, tone: 'ask' };
  if (status.alarms.length > 0) return { text: a.alarm, tone: 'bad' };
  if (status.machineState === 'off') return { text: a.off, tone: 'ask' };
  if (status.toolChange === 'operator') return { text: a.toolChange(status.toolWanted), tone: 'ask' };
  if (status.toolChange === 'program') return { text: a.toolChanging(status.toolWanted), tone: 'calm' };
  if (status.toolUnknown) return { text: a.toolUnknown, tone: 'ask' };
  if (status.activity === 'homing') return { text: a.homing, tone: 'calm' };
  if (status.activity === 'jog') return { text: a.jogging, tone: 'calm' };
  if (status.activity === 'program' || status.activity === 'mdi') {
    if (status.awayParts > 0 && excursionMoves(status)) return { text: a.awayMoves, tone: 'calm' };
    if (status.awayParts > 0) return { text: a.away(machine.axes.filter((_, index) => status.away[index]).map((axis) => axis.letter).join(' ')), tone: 'ask' };
    if (status.state === 'program_stop') return { text: message || a.programStop, tone: 'ask' };
    if (status.state === 'held' || status.hold) return { text: a.held, tone: 'ask' };
    if (status.inputWait) return { text: a.inputWait, tone: 'calm' };
    if (isBetween(status)) return { text: status.state === 'idle' ? a.starting : a.ending, tone: 'calm' };
    return { text: a.running(status.line), tone: 'calm' };
  }
  const unhomed = machine.axes.filter((_, index) => !status.homed[index]).map((axis) => axis.letter);
  if (unhomed.length > 0) return { text: a.home(unhomed.join(' ')), tone: 'ask' };
  // The core loads no program with errors: what was chosen last is told, not what may be loaded from before.
  if (program && program.errors.length > 0) return { text: a.programErrors(program.errors.length), tone: 'bad' };
  if (!status.program) return { text: a.noProgram, tone: 'calm' };
  const loaded = status.program.replace(/^.*\//, '');
  if (isOtherProgram) return { text: a.otherProgram(loaded, program?.name ?? ''), tone: 'ask' };
  if (program?.problem) return { text: a.notShown(loaded, program.problem), tone: 'ask' };
  if (program && !program.checked) return { text: a.checking, tone: 'calm' };
  return { text: a.ready(loaded), tone: 'calm' };
}
