// Which licences do the packages bear that package-lock.json names? Those that are built into the page have to be permissive, as
// deny.toml demands of crates; those that only build or test it may be weak copyleft, for they are not given to anybody.
import { readFileSync } from 'node:fs';

const shipped = new Set(['0BSD', 'Apache-2.0', 'BSD-3-Clause', 'ISC', 'MIT', 'Zlib', '(MIT OR Apache-2.0)', 'MIT OR Apache-2.0']);
const tools = new Set([...shipped, 'MPL-2.0', 'BSD-2-Clause', 'CC0-1.0', 'BlueOak-1.0.0']);
/** What ends up in dist, and what these depend on at run time. */
const roots = ['svelte', 'three', 'uplot'];

const lock = JSON.parse(readFileSync(new URL('../package-lock.json', import.meta.url), 'utf8'));
const packages = new Map(Object.entries(lock.packages).filter(([path]) => path !== '').map(([path, entry]) => [path.replace(/^.*node_modules\//, ''), entry]));

const inside = new Set();
const add = (name) => {
  if (inside.has(name) || !packages.has(name)) return;
  inside.add(name);
  Object.keys(packages.get(name).dependencies ?? {}).forEach(add);
};
roots.forEach(add);

let bad = 0;
for (const [name, entry] of packages) {
  const allowed = inside.has(name) ? shipped : tools;
  if (!allowed.has(entry.license)) {
    console.error(`${name} ${entry.version}: licence ${entry.license} is not permitted ${inside.has(name) ? 'in the page' : 'for tools'}`);
    bad += 1;
  }
}
for (const root of roots) {
  if (!packages.has(root)) {
    console.error(`${root} is not in package-lock.json`);
    bad += 1;
  }
}
process.exit(bad === 0 ? 0 : 1);
