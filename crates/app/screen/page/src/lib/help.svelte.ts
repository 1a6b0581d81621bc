// The documentation, which the server has in it: pages are shown in a frame, and nothing is asked of other sites.
import { settings } from './settings.svelte';

class Help {
  /** what is shown, or empty */
  address = $state('');

  /** An address below the page's own; `place` is a heading of the document. */
  addressOf(name: string, place = ''): string {
    return `docs/${settings.theme}/${name}.html${place && `#${place}`}`;
  }

  show(name: string, place = ''): void {
    this.address = this.addressOf(name, place);
  }
}

export const help = new Help();
