import type { Component } from 'svelte';
import type { Machine } from '../lib/model';
import Cut from './Cut.svelte';
import Events from './Events.svelte';
import Io from './Io.svelte';
import Jog from './Jog.svelte';
import Mdi from './Mdi.svelte';
import Offsets from './Offsets.svelte';
import Path from './Path.svelte';
import Program from './Program.svelte';
import Scope from './Scope.svelte';
import Tools from './Tools.svelte';
import Traces from './Traces.svelte';

export type ViewName = 'jog' | 'program' | 'path' | 'mdi' | 'offsets' | 'tools' | 'scope' | 'events' | 'traces' | 'io' | 'cut';

export const views: { name: ViewName; component: Component }[] = [
  { name: 'jog', component: Jog },
  { name: 'program', component: Program },
  { name: 'path', component: Path },
  { name: 'mdi', component: Mdi },
  { name: 'offsets', component: Offsets },
  { name: 'tools', component: Tools },
  { name: 'scope', component: Scope },
  { name: 'events', component: Events },
  { name: 'traces', component: Traces },
  { name: 'io', component: Io },
  { name: 'cut', component: Cut },
];

/** The views of a machine: those of signals and of the cut only where there is something to show. */
export function viewsOf(machine: Machine | null): ViewName[] {
  const cuts = machine?.kind === 'lathe' || machine?.hasChatter === true;
  const signals = machine !== null && machine.inputs.length + machine.outputs.length + machine.spindles.length > 0;
  return views.map((view) => view.name).filter((name) => (name !== 'cut' || cuts) && (name !== 'io' || signals));
}
