//! The planner on one thread, or its two stages on one thread each.

use std::collections::VecDeque;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use evolvent_gcode::Move;
use evolvent_machine::PlannerKind;
use evolvent_motion::QueueClosed;
use evolvent_path::Axes;
use evolvent_planner::{MoveValidator, PathItem, PathStage, PlanError, PlanSink, Planner, Step, TimingStage};

use crate::job::Setup;
use crate::tally::Tally;

/// Capacity of the queue of moves from path stage to timing stage.
const LOTS: usize = 256;
/// Maximum wait of the timing stage for path before it checks for requests of the cycle.
const POLL_INTERVAL: Duration = Duration::from_micros(100);

/// Plans one program. Both variants give the same plan, bit for bit.
#[expect(clippy::large_enum_variant, reason = "there is one of it")]
pub(crate) enum Stages<S> {
    /// On the calling thread.
    One(Planner<Tally<S>>),
    /// The path on the calling thread, its time law on another one.
    Two(TwoThreadPlanner),
}

impl<S: PlanSink<Error = QueueClosed>> Stages<S> {
    pub(crate) fn one(setup: &Setup, feed_override: f64, sink: S) -> Self {
        let rules = setup.path_rules(feed_override);
        Self::One(Planner::new(setup.path_limits(), rules, Tally::new(sink)))
    }

    /// On two threads, if the machine's planner has two stages.
    ///
    /// # Errors
    /// The operating system cannot start a thread.
    pub(crate) fn two(setup: &Setup, feed_override: f64, sink: S) -> io::Result<Self>
    where
        S: Send + 'static,
    {
        let rules = setup.path_rules(feed_override);
        if rules.planner == PlannerKind::Classic {
            return Ok(Self::one(setup, feed_override, sink));
        }
        let limits = setup.path_limits();
        let pacer = TimingStage::new(&limits, &rules, Tally::new(sink));
        let (lots, path) = sync_channel(LOTS);
        let (teller, events) = channel();
        let failed_at = Arc::new(OnceLock::new());
        let telling = Arc::clone(&failed_at);
        let thread = thread::Builder::new()
            .name("time law".into())
            .spawn(move || pace(pacer, &path, &teller, &telling))?;
        Ok(Self::Two(TwoThreadPlanner {
            validator: MoveValidator::new(limits.axes()),
            shaper: PathStage::new(&limits, rules),
            lots: Some(lots),
            events,
            failed_at,
            thread: Some(thread),
            finished: VecDeque::new(),
            planned_s: 0.0,
        }))
    }

    /// See [`Planner::push`].
    pub(crate) fn push(
        &mut self,
        motion: &Move,
        line: u32,
        block: u32,
    ) -> Result<(), PlanError<QueueClosed>> {
        match self {
            Self::One(planner) => planner.push(motion, line, block),
            Self::Two(relay) => relay.push(motion, line, block),
        }
    }

    /// See [`Planner::rest`].
    pub(crate) fn rest(&mut self, step: &Step) -> Result<(), QueueClosed> {
        match self {
            Self::One(planner) => planner.rest(step),
            Self::Two(relay) => relay.rest(*step),
        }
    }

    /// See [`Planner::set_position`].
    pub(crate) fn set_position(&mut self, position: &Axes) {
        match self {
            Self::One(planner) => planner.set_position(position),
            Self::Two(relay) => relay.validator.set_position(position),
        }
    }

    /// See [`Planner::finish`].
    pub(crate) fn finish(&mut self, line: u32) -> Result<(), QueueClosed> {
        match self {
            Self::One(planner) => planner.finish(line),
            Self::Two(relay) => relay.finish(line),
        }
    }

    /// See [`Planner::poll`].
    pub(crate) fn poll(&mut self) -> Result<(), QueueClosed> {
        match self {
            Self::One(planner) => planner.poll(),
            // The other thread polls by itself.
            Self::Two(_) => Ok(()),
        }
    }

    /// See [`Planner::serve_until_closed`].
    pub(crate) fn serve_until_closed(&mut self) {
        match self {
            Self::One(planner) => planner.serve_until_closed(),
            Self::Two(relay) => relay.serve_until_closed(),
        }
    }

    pub(crate) fn deviation_mm(&self) -> f64 {
        match self {
            Self::One(planner) => planner.deviation_mm(),
            Self::Two(relay) => relay.shaper.deviation_mm(),
        }
    }

    /// Planned seconds; with two threads only once they have ended.
    pub(crate) fn planned_s(&self) -> f64 {
        match self {
            Self::One(planner) => planner.sink().planned_s,
            Self::Two(relay) => relay.planned_s,
        }
    }

    /// Blocks whose plan is final, with their seconds; the last one may still grow.
    pub(crate) fn finished(&mut self) -> &mut VecDeque<(u32, f64)> {
        match self {
            Self::One(planner) => &mut planner.sink_mut().finished,
            Self::Two(relay) => {
                relay.listen();
                &mut relay.finished
            }
        }
    }
}

/// Events from the timing stage to the path stage.
enum TimingStageEvent {
    Block((u32, f64)),
    /// The whole path is planned.
    End,
}

/// The path stage, and the queues to the timing stage.
pub(crate) struct TwoThreadPlanner {
    validator: MoveValidator,
    shaper: PathStage,
    /// The path of each move; `None` once the path has ended.
    lots: Option<SyncSender<Vec<PathItem>>>,
    events: Receiver<TimingStageEvent>,
    /// The line from which no motion was found.
    failed_at: Arc<OnceLock<u32>>,
    /// Returns the seconds that it has planned.
    thread: Option<JoinHandle<f64>>,
    finished: VecDeque<(u32, f64)>,
    planned_s: f64,
}

impl TwoThreadPlanner {
    fn push(&mut self, motion: &Move, line: u32, block: u32) -> Result<(), PlanError<QueueClosed>> {
        self.validator.validate(motion)?;
        let mut lot = Vec::new();
        self.shaper.push(motion, line, block, &mut lot);
        let sent = self.send(lot);
        match self.failed_at.get() {
            Some(&line) => Err(PlanError::NoMotion { line }),
            None => sent.map_err(PlanError::Sink),
        }
    }

    fn rest(&mut self, step: Step) -> Result<(), QueueClosed> {
        let mut lot = Vec::new();
        self.shaper.rest(step, &mut lot);
        self.send(lot)
    }

    fn send(&self, lot: Vec<PathItem>) -> Result<(), QueueClosed> {
        // An empty lot is sent as well: the timing stage plans after every move, as one thread does.
        let lots = self.lots.as_ref().ok_or(QueueClosed)?;
        lots.send(lot).map_err(|_| QueueClosed)
    }

    fn finish(&mut self, line: u32) -> Result<(), QueueClosed> {
        let sent = self.rest(Step::End { line });
        // The other thread has planned everything, or has ended, once its channel is closed.
        self.lots = None;
        while let Ok(TimingStageEvent::Block(block)) = self.events.recv() {
            self.finished.push_back(block);
        }
        sent
    }

    fn listen(&mut self) {
        while let Ok(TimingStageEvent::Block(block)) = self.events.try_recv() {
            self.finished.push_back(block);
        }
    }

    fn serve_until_closed(&mut self) {
        self.lots = None;
        if let Some(thread) = self.thread.take() {
            // A panic of a thread is a bug; it is passed on.
            self.planned_s = thread
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    }
}

/// The timing stage: path in, plan out, until the cycle has ended. Returns the seconds that it has planned.
fn pace<S: PlanSink<Error = QueueClosed>>(
    mut pacer: TimingStage<Tally<S>>,
    path: &Receiver<Vec<PathItem>>,
    teller: &Sender<TimingStageEvent>,
    failed_at: &OnceLock<u32>,
) -> f64 {
    loop {
        match path.recv_timeout(POLL_INTERVAL) {
            Ok(lot) => lot.into_iter().for_each(|item| item.apply_to(&mut pacer)),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        let closed = pacer.poll().is_err();
        tell(&mut pacer, teller, 1);
        if let Some(line) = pacer.failed_at() {
            failed_at.get_or_init(|| line);
        }
        if closed || failed_at.get().is_some() {
            return pacer.sink().planned_s;
        }
    }
    tell(&mut pacer, teller, 0);
    // The listener may have gone.
    let _gone = teller.send(TimingStageEvent::End);
    // Replies to holds and overrides while the program runs. It returns when nothing can send requests any
    // more.
    let _gone = pacer.serve_until_closed();
    pacer.sink().planned_s
}

fn tell<S: PlanSink<Error = QueueClosed>>(
    pacer: &mut TimingStage<Tally<S>>,
    teller: &Sender<TimingStageEvent>,
    keep: usize,
) {
    let finished = &mut pacer.sink_mut().finished;
    while finished.len() > keep {
        let Some(block) = finished.pop_front() else { break };
        let _gone = teller.send(TimingStageEvent::Block(block));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "tests fail as tests do")]

    use std::path::Path;
    use std::sync::Mutex;

    use evolvent_gcode::{MoveKind, PathMode};
    use evolvent_machine::Machine;
    use evolvent_path::{Axes, Curve, Line};
    use evolvent_planner::{BlockMark, ExitSpeeds, Segment};

    use super::*;

    /// Collects everything in order, for inspection.
    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<Vec<String>>>);

    impl Kept {
        fn keep(&self, what: String) -> Result<(), QueueClosed> {
            self.0.lock().expect("nobody panicked").push(what);
            Ok(())
        }

        fn all(&self) -> Vec<String> {
            self.0.lock().expect("nobody panicked").clone()
        }
    }

    impl PlanSink for Kept {
        type Error = QueueClosed;
        fn segment(&mut self, segment: &Segment) -> Result<(), QueueClosed> {
            self.keep(format!("{segment:?}"))
        }
        fn step(&mut self, step: &Step) -> Result<(), QueueClosed> {
            self.keep(format!("{step:?}"))
        }
        fn exit(&mut self, index: u64, speeds: ExitSpeeds) {
            let _kept = self.keep(format!("{index} {speeds:?}"));
        }
        fn commit(&mut self, count: u64) {
            let _kept = self.keep(format!("final {count}"));
        }
        fn mark(&mut self, mark: &BlockMark) -> Result<(), QueueClosed> {
            self.keep(format!("{mark:?}"))
        }
        fn link(&mut self, from: u64, to: u64) -> bool {
            self.keep(format!("{from} then {to}")).is_ok()
        }
        fn wait(&mut self) -> Result<(), QueueClosed> {
            Err(QueueClosed)
        }
    }

    /// A consumer that takes this number of steps and ends.
    struct Leaving(u32);

    impl PlanSink for Leaving {
        type Error = QueueClosed;
        fn segment(&mut self, _: &Segment) -> Result<(), QueueClosed> {
            Ok(())
        }
        fn step(&mut self, _: &Step) -> Result<(), QueueClosed> {
            self.0 = self.0.checked_sub(1).ok_or(QueueClosed)?;
            Ok(())
        }
        fn exit(&mut self, _: u64, _: ExitSpeeds) {}
        fn commit(&mut self, _: u64) {}
    }

    fn setup() -> Setup {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let machine = Machine::load(&file).expect("a machine");
        Setup::new(machine, file, String::new(), None).expect("a setup")
    }

    fn corner(k: u32) -> Move {
        let at = |k: u32| {
            let mut point = Axes::zeros();
            (point[0], point[1]) = (f64::from(k % 7), f64::from(k % 5));
            point
        };
        let blend = PathMode::Blend {
            tolerance_mm: Some(0.02),
            merge_mm: None,
        };
        Move {
            curve: Curve::Line(Line::new(at(k), at(k + 1)).expect("a line")),
            kind: MoveKind::Feed,
            feed_mm_s: 50.0,
            path_mode: if k % 100 < 75 { blend } else { PathMode::ExactPath },
        }
    }

    fn plan(mut planner: Stages<Kept>) -> (f64, f64, Vec<(u32, f64)>) {
        for k in 0..150 {
            planner.push(&corner(k), k + 1, k).expect("a plan");
            if k % 50 == 49 {
                planner
                    .rest(&Step::Action { action: k, line: k })
                    .expect("a plan");
            }
        }
        planner.finish(151).expect("a plan");
        let blocks = planner.finished().iter().copied().collect();
        planner.serve_until_closed();
        (planner.planned_s(), planner.deviation_mm(), blocks)
    }

    #[test]
    fn two_threads_give_the_same_plan_bit_for_bit() {
        let (setup, one, two) = (setup(), Kept::default(), Kept::default());
        let of_one = plan(Stages::one(&setup, 0.8, one.clone()));
        let of_two = plan(Stages::two(&setup, 0.8, two.clone()).expect("a thread"));
        assert!(one.all().len() > 1000, "{} entries", one.all().len());
        assert!(one.all() == two.all(), "another plan, or another order");
        assert_eq!(of_one, of_two, "seconds, deviation, blocks");
        assert_eq!(of_one.2.len(), 150);
    }

    #[test]
    fn a_consumer_that_has_gone_ends_both_threads() {
        let mut planner = Stages::two(&setup(), 1.0, Leaving(100)).expect("a thread");
        let (teller, events) = channel();
        // On a separate thread: a planner that never ends would not fail the test.
        thread::spawn(move || {
            let ended = (0..100_000).find_map(|k| planner.push(&corner(k), k + 1, k).err());
            let finished = planner.finish(1);
            planner.serve_until_closed();
            let _gone = teller.send((ended, finished));
        });
        let ends = events.recv_timeout(Duration::from_secs(120));
        let (ended, finished) = ends.expect("an end of both threads");
        assert_eq!(ended, Some(PlanError::Sink(QueueClosed)));
        assert_eq!(finished, Err(QueueClosed));
    }
}
