import type { Source } from './source';
import { Server } from './server';

/** The server that the page came from; while developing (`npm run dev`) with `?made-up` a machine that exists in the page only. */
export async function connect(): Promise<Source> {
  if (import.meta.env.DEV && new URLSearchParams(location.search).has('made-up')) {
    const { MadeUp } = await import('./made-up');
    return new MadeUp();
  }
  return new Server();
}
