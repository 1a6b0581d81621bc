import type { Component } from 'svelte';
import Events from './Events.svelte';
import Jog from './Jog.svelte';
import Mdi from './Mdi.svelte';
import Offsets from './Offsets.svelte';
import Path from './Path.svelte';
import Program from './Program.svelte';
import Scope from './Scope.svelte';
import Tools from './Tools.svelte';

export type ViewName = 'jog' | 'program' | 'path' | 'mdi' | 'offsets' | 'tools' | 'scope' | 'events';

export const views: { name: ViewName; component: Component }[] = [
  { name: 'jog', component: Jog },
  { name: 'program', component: Program },
  { name: 'path', component: Path },
  { name: 'mdi', component: Mdi },
  { name: 'offsets', component: Offsets },
  { name: 'tools', component: Tools },
  { name: 'scope', component: Scope },
  { name: 'events', component: Events },
];
