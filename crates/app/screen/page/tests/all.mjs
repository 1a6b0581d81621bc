// Every case, in the order in which they run: a machine begins in emergency stop.
import './cases/power.mjs';
import './cases/stop.mjs';
import './cases/jog.mjs';
import './cases/override.mjs';
import './cases/mdi.mjs';
import './cases/offset.mjs';
import './cases/program.mjs';
import './cases/path.mjs';
import './cases/scope.mjs';
import './cases/recording.mjs';
import './cases/signal.mjs';
import './cases/alarm.mjs';
import './cases/lathe.mjs';
import './cases/page.mjs';

export { cases } from './case.mjs';
