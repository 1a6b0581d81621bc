// Cases: what an operator does at a page, and where that can be tried.

/** All that were declared, in order: `places` has 'machine' and 'made-up', `need` the entry of the context without which it is not measured. */
export const cases = [];

const declare = (places, name, run, need) => {
  if (cases.some((other) => other.name === name)) throw new Error(`two cases have the name '${name}'`);
  cases.push({ name, places, run, need });
};

/** On a service with simulated drives as on the made-up machine of `npm run dev`. */
export const anywhere = (name, run, need) => declare(['machine', 'made-up'], name, run, need);
/** With what only a service has: its files, plans and other clients. */
export const onMachine = (name, run, need) => declare(['machine'], name, run, need);
/** With a machine that does at the right moment what a real one does seldom. */
export const onMadeUp = (name, run, need) => declare(['made-up'], name, run, need);
