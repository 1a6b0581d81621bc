//! Commands of pages on their way to the core. Only the page in control can move anything, and motion that
//! must be watched ends when that page loses control.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use evolvent_bus::{ControlRequest, Status};
use evolvent_control::CommandCode;

use crate::command::STOPPING;
use crate::hub::{Hub, Term};
use crate::messages::{CommandMessage, Refusal};
use crate::orders::{Answer, Orders};

/// Maximum age of a jog renewal.
const KEEP_AGE: Duration = Duration::from_millis(40);
/// Maximum age of a jog.
const JOG_AGE: Duration = Duration::from_millis(250);
/// Maximum age of commands that stop.
const AGE: Duration = Duration::from_secs(5);
/// Maximum age of other commands: later the operator may be looking elsewhere.
const PRESS_AGE: Duration = Duration::from_secs(1);
/// Maximum age of a LOAD, which waits for earlier commands.
const LOAD_AGE: Duration = Duration::from_secs(12);
/// Maximum age of the status that a page showed when it sent a command that does not stop. When a dead link
/// recovers, it delivers what was sent many seconds earlier.
const MAX_SEEN_AGE_NS: u64 = 1_000_000_000;

/// `activity` of a jog in the status.
const JOG: u32 = 3;

/// The connections to the core.
pub(crate) struct Dispatch {
    hub: Arc<Hub>,
    /// Commands that stop.
    stops: Orders,
    /// Jogs and their renewals, which the core accepts from one client only.
    jogs: Orders,
    /// All others.
    commands: Orders,
    /// A page has jogged since jogs were stopped.
    jogged: AtomicBool,
}

impl Dispatch {
    pub(crate) fn new(hub: Arc<Hub>, stops: Orders, jogs: Orders, commands: Orders) -> Self {
        Self {
            hub,
            stops,
            jogs,
            commands,
            jogged: AtomicBool::new(false),
        }
    }

    /// Stops a jog when the page that holds it has disconnected or lost control. The core would notice 90 ms
    /// later.
    pub(crate) fn stop_jog(&self) {
        if self.jogged.swap(false, Ordering::Relaxed) {
            self.stops.send(plain(CommandCode::JogStop), AGE, None);
        }
    }

    /// The operator at a page still holds the jog.
    pub(crate) fn keep_jog(&self, page: u64) {
        if let Some(term) = self.hub.term(page) {
            self.jogs.send(plain(CommandCode::JogKeep), KEEP_AGE, Some(term));
        }
    }

    /// Sends a command if the page may send it now. Returns the core's answer, or the reason why nothing was
    /// sent.
    pub(crate) async fn carry_out(
        &self,
        page: u64,
        command: &CommandMessage,
        request: ControlRequest,
    ) -> Answer {
        let is_code = |code: &CommandCode| *code as u32 == command.command;
        if STOPPING.iter().any(is_code) {
            if is_code(&CommandCode::JogStop) {
                // Also after a jog that has not been sent yet: a short press must not start a jog after its
                // end.
                self.jogs.send(request, JOG_AGE, None);
            }
            return self.stops.give(request, AGE, None).await;
        }
        let Some(term) = self.hub.term(page) else {
            return Refusal::NoControl.into();
        };
        if let Some(refusal) = outdated(self.hub.present().as_deref(), command) {
            return refusal.into();
        }
        match command.command {
            code if code == CommandCode::Jog as u32 => {
                self.give_watched(&self.jogs, request, JOG_AGE, term).await
            }
            code if code == CommandCode::JogKeep as u32 => {
                self.jogs.give(request, KEEP_AGE, Some(term)).await
            }
            // Like a jog, these end with the page: motion outside the program must be watched.
            code if code == CommandCode::Return as u32 || code == CommandCode::Retrace as u32 => {
                self.give_watched(&self.commands, request, PRESS_AGE, term).await
            }
            _ => self.commands.give(request, PRESS_AGE, Some(term)).await,
        }
    }

    /// Loads a program that a page has uploaded.
    pub(crate) async fn load(&self, request: ControlRequest, term: Term) -> Answer {
        self.commands.give(request, LOAD_AGE, Some(term)).await
    }

    /// Sends a command that moves only as long as the page that sent it has control.
    async fn give_watched(
        &self,
        orders: &Orders,
        request: ControlRequest,
        max_age: Duration,
        term: Term,
    ) -> Answer {
        self.jogged.store(true, Ordering::Relaxed);
        let answer = orders.give(request, max_age, Some(term)).await;
        // The page may have lost control while the core evaluated the command. The stop sent at that moment
        // came before the motion began, and reset `jogged`. It therefore has to be sent again, regardless of
        // `jogged`.
        if !self.hub.is_present(term) {
            self.stops.send(plain(CommandCode::JogStop), AGE, None);
        }
        answer
    }
}

fn plain(code: CommandCode) -> ControlRequest {
    ControlRequest {
        command: code as u32,
        ..ControlRequest::default()
    }
}

/// The reason why a command that does not stop is out of date, if it is. Without a status the core rejects
/// it, or nothing moves.
fn outdated(present: Option<&Status>, command: &CommandMessage) -> Option<Refusal> {
    let present = present?;
    if present.time_ns.saturating_sub(command.seen_ns) > MAX_SEEN_AGE_NS {
        return Some(Refusal::OutOfDate);
    }
    (command.steers && present.activity != JOG).then_some(Refusal::JogEnded)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::sync::{Condvar, Mutex, MutexGuard};
    use std::time::Instant;

    use evolvent_disturbance::unless_disturbed;

    use super::*;
    use crate::gate::Role;
    use crate::hub::Visitor;
    use crate::messages::ToPage;
    use crate::orders::Core;

    #[test]
    fn a_command_of_a_page_that_is_out_of_date_is_refused() {
        let mut present = Status {
            time_ns: 100_000_000_000,
            activity: JOG,
            ..Status::default()
        };
        let command = |seen_ns: u64, steers: bool| -> CommandMessage {
            let json = serde_json::json!({"id": 1, "command": 20, "seen_ns": seen_ns, "steers": steers});
            serde_json::from_value(json).unwrap()
        };
        // A second, and the future: the status is that of the last setpoint, which pages may have from the
        // previous frame.
        for seen_ns in [99_000_000_000, 100_000_000_000, 100_010_000_000] {
            assert_eq!(outdated(Some(&present), &command(seen_ns, true)), None);
        }
        // A link that was dead for 12 s, and a page that has received no status.
        for seen_ns in [98_999_999_999, 88_000_000_000, 0] {
            let refusal = outdated(Some(&present), &command(seen_ns, false));
            assert_eq!(refusal, Some(Refusal::OutOfDate));
        }
        // The jog was stopped: a change of a jog does not start one.
        present.activity = 0;
        let refusal = outdated(Some(&present), &command(100_000_000_000, true));
        assert_eq!(refusal, Some(Refusal::JogEnded));
        assert_eq!(outdated(Some(&present), &command(100_000_000_000, false)), None);
        assert_eq!(outdated(None, &command(0, true)), None);
    }

    /// A request that the core replies to and does not list: after it, everything sent before on the same
    /// connection was evaluated.
    const MARKER: u32 = u32::MAX;
    /// Longer than any host suspends a thread.
    const FOREVER: Duration = Duration::from_secs(60);

    /// Commands received by a core.
    #[derive(Default)]
    struct Progress {
        /// Commands whose evaluation has begun.
        begun: Vec<u32>,
        /// Commands that have taken effect.
        done: Vec<u32>,
        /// Commands take effect; until then their evaluation does not finish.
        is_open: bool,
    }

    /// A core that evaluates a command until it is released. Stops take no time.
    #[derive(Clone, Default)]
    struct SlowCore(Arc<(Mutex<Progress>, Condvar)>);

    impl SlowCore {
        fn progress(&self) -> MutexGuard<'_, Progress> {
            self.0.0.lock().unwrap()
        }

        /// Lets commands take effect from now on.
        fn let_go_on(&self) {
            self.progress().is_open = true;
            self.0.1.notify_all();
        }
    }

    impl Core for SlowCore {
        fn open(&mut self) -> Result<(), String> {
            Ok(())
        }

        fn open_early(&mut self) {}

        fn command(&mut self, request: &ControlRequest) -> Answer {
            let code = request.command;
            if code != MARKER {
                let mut progress = self.progress();
                progress.begun.push(code);
                if code != STOP {
                    let is_closed = |progress: &mut Progress| !progress.is_open;
                    progress = self.0.1.wait_while(progress, is_closed).unwrap();
                }
                progress.done.push(code);
            }
            Answer {
                accepted: true,
                alarm: 0,
                text: String::new(),
                refusal: None,
            }
        }
    }

    /// Two pages that may operate; the first has control.
    struct Scene {
        hub: Arc<Hub>,
        dispatch: Dispatch,
        pages: [u64; 2],
        core: SlowCore,
        stop: Arc<AtomicBool>,
        _messages: Vec<tokio::sync::mpsc::Receiver<axum::extract::ws::Utf8Bytes>>,
    }

    impl Scene {
        async fn new() -> Self {
            let hub = Arc::new(Hub::new(ToPage::Core { alive: false }));
            let (core, stop) = (SlowCore::default(), Arc::new(AtomicBool::new(false)));
            let orders = |name| {
                let core = core.clone();
                let (orders, _thread) = Orders::spawn(name, move || core, &hub, &stop).unwrap();
                orders
            };
            let dispatch = Dispatch::new(
                Arc::clone(&hub),
                orders("stops"),
                orders("jogs"),
                orders("orders"),
            );
            let mut messages = Vec::new();
            let pages = [0, 1].map(|_| {
                let (page, receiver) = hub
                    .join(Visitor {
                        session: String::new(),
                        role: Role::Operate,
                        client: std::net::Ipv4Addr::LOCALHOST.into(),
                    })
                    .unwrap();
                messages.push(receiver);
                page
            });
            hub.take(pages[0], false);
            let scene = Self {
                hub,
                dispatch,
                pages,
                core,
                stop,
                _messages: messages,
            };
            // The threads run, so their start-up time does not count as that of a command.
            scene.evaluated().await;
            scene
        }

        async fn press(&self, code: CommandCode) -> Answer {
            let json = serde_json::json!({"id": 1, "command": code as u32});
            let command: CommandMessage = serde_json::from_value(json).unwrap();
            self.dispatch
                .carry_out(self.pages[0], &command, plain(code))
                .await
        }

        /// The second page takes control away.
        fn lose(&self) {
            assert!(self.hub.take(self.pages[1], true));
            self.dispatch.stop_jog();
        }

        /// Waits until a condition holds for what the core has received.
        async fn until(&self, what: &str, is_so: impl Fn(&Progress) -> bool) {
            let begun = Instant::now();
            while !is_so(&self.core.progress()) {
                assert!(begun.elapsed() < FOREVER, "{what} does not come");
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        }

        /// Waits until everything sent so far was evaluated.
        async fn evaluated(&self) {
            let dispatch = &self.dispatch;
            for orders in [&dispatch.commands, &dispatch.jogs, &dispatch.stops] {
                let request = ControlRequest {
                    command: MARKER,
                    ..ControlRequest::default()
                };
                assert!(orders.give(request, FOREVER, None).await.accepted);
            }
        }

        /// What the core has received, once it has received everything.
        async fn settled(&self) -> Vec<u32> {
            self.evaluated().await;
            self.stop.store(true, Ordering::Relaxed);
            self.core.progress().done.clone()
        }
    }

    /// Runs a test, again if the host suspended it, because commands expire.
    fn run<T: Future<Output = ()>>(test: impl Fn() -> T) {
        unless_disturbed(|| {
            tokio::runtime::Builder::new_current_thread()
                .enable_time()
                .build()
                .unwrap()
                .block_on(test());
        });
    }

    const STOP: u32 = CommandCode::JogStop as u32;

    #[test]
    fn a_motion_is_stopped_if_its_page_has_lost_control() {
        for code in [CommandCode::Return, CommandCode::Retrace, CommandCode::Jog] {
            for takes_back in [false, true] {
                run(|| async move {
                    let scene = Scene::new().await;
                    let lost = async {
                        scene
                            .until("the command", |core| core.begun == [code as u32])
                            .await;
                        scene.lose();
                        // This stop comes before the motion begins, and stops nothing.
                        scene.until("the first stop", |core| core.done == [STOP]).await;
                        if takes_back {
                            assert!(scene.hub.take(scene.pages[0], true));
                        }
                        scene.core.let_go_on();
                    };
                    let (answer, ()) = tokio::join!(scene.press(code), lost);
                    assert!(answer.accepted);
                    assert_eq!(
                        scene.settled().await,
                        [STOP, code as u32, STOP],
                        "{code:?} {takes_back}"
                    );
                });
            }
        }
    }

    #[test]
    fn a_waiting_command_is_dropped_when_control_is_lost() {
        for code in [
            CommandCode::Start,
            CommandCode::Mdi,
            CommandCode::Home,
            CommandCode::Return,
            CommandCode::Retrace,
        ] {
            run(|| async move {
                let scene = Scene::new().await;
                let first = scene.press(CommandCode::Mode);
                let is_pressed = Cell::new(false);
                let waits = async {
                    let mode = CommandCode::Mode as u32;
                    scene.until("the first", |core| core.begun == [mode]).await;
                    // Queued before anything else of this thread runs.
                    is_pressed.set(true);
                    scene.press(code).await
                };
                let lost = async {
                    while !is_pressed.get() {
                        tokio::time::sleep(Duration::from_millis(1)).await;
                    }
                    scene.lose();
                    // Control that was regained is a new term: another operator may be at the page.
                    assert!(scene.hub.give(scene.pages[1]));
                    scene.hub.take(scene.pages[0], false);
                    assert!(scene.hub.term(scene.pages[0]).is_some());
                    scene.core.let_go_on();
                };
                let (first, answer, ()) = tokio::join!(first, waits, lost);
                assert!(first.accepted);
                assert_eq!(
                    (answer.accepted, answer.refusal),
                    (false, Some(Refusal::LostControl))
                );
                let seen = scene.settled().await;
                assert!(!seen.contains(&(code as u32)), "{code:?}: {seen:?}");
            });
        }
    }

    #[test]
    fn a_renewal_of_a_page_without_control_is_not_sent() {
        run(|| async {
            let scene = Scene::new().await;
            scene.core.let_go_on();
            scene.dispatch.keep_jog(scene.pages[1]);
            scene.dispatch.keep_jog(scene.pages[0]);
            assert_eq!(scene.settled().await, [CommandCode::JogKeep as u32]);
        });
    }
}
