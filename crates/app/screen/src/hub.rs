//! The pages, the page in control, and the messages to all pages.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use evolvent_bus::Status;
use tokio::sync::{mpsc, watch};

use crate::event_log::EventLog;
use crate::gate::Role;
use crate::messages::{EndOf, Lease, LogFact, LogKind, ProgramInfo, ToPage};
use crate::watcher::Frame;

/// Maximum number of pages at the same time.
const MAX_PAGES: usize = 64;
/// Maximum number of messages waiting for a slow page; beyond it the page is disconnected.
const WAITING: usize = 256;

/// Maximum number of pages that only watch; the others are reserved for operators.
const MAX_WATCHING: usize = 48;
/// Maximum number of pages that only watch from another computer.
const MAX_WATCHING_CLIENT: usize = 16;

/// A client that opens a page.
#[derive(Clone, Debug)]
pub(crate) struct Visitor {
    pub(crate) session: String,
    pub(crate) role: Role,
    /// The identity of one client.
    pub(crate) client: IpAddr,
}

/// The control of one page, from taking it to losing it. Control that is regained is a new term.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Term {
    page: u64,
    number: u64,
}

struct Page {
    sender: mpsc::Sender<Utf8Bytes>,
    session: String,
    role: Role,
    client: IpAddr,
}

#[derive(Default)]
struct Inner {
    pages: BTreeMap<u64, Page>,
    next_page: u64,
    holder: Option<u64>,
    /// Number of the newest term.
    terms: u64,
    log: EventLog,
    program: Option<ProgramInfo>,
    /// The program in the status while a rejected upload is shown.
    beside: Option<String>,
    kept: Option<ToPage>,
    macros: Option<ToPage>,
}

/// Data shared by all threads of the server. No lock is held during a wait.
pub(crate) struct Hub {
    inner: Mutex<Inner>,
    frames: watch::Sender<Frame>,
    machine: ToPage,
}

impl Hub {
    pub(crate) fn new(machine: ToPage) -> Self {
        Self {
            inner: Mutex::default(),
            frames: watch::Sender::new(Frame::default()),
            machine,
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The latest frame, for pages that are ready for one.
    pub(crate) fn frames(&self) -> watch::Receiver<Frame> {
        self.frames.subscribe()
    }

    /// Publishes the next frame; `present` is the status that it shows, if there is one.
    pub(crate) fn show(
        &self,
        status: &ToPage,
        samples: Bytes,
        signals: Utf8Bytes,
        present: Option<Arc<Status>>,
    ) {
        let status = text(status);
        self.frames.send_replace(Frame {
            status,
            samples,
            signals,
            present,
        });
    }

    /// The status that is shown; `None` if there is none.
    pub(crate) fn present(&self) -> Option<Arc<Status>> {
        self.frames.borrow().present.clone()
    }

    /// Adds a page, whose snapshot is in the channel; `None` if there are too many.
    pub(crate) fn join(&self, visitor: Visitor) -> Option<(u64, mpsc::Receiver<Utf8Bytes>)> {
        let mut inner = self.lock();
        if inner.pages.len() >= MAX_PAGES || (visitor.role == Role::Watch && !inner.may_watch(visitor.client))
        {
            return None;
        }
        let Visitor {
            session,
            role,
            client,
        } = visitor;
        let (sender, receiver) = mpsc::channel(WAITING);
        inner.next_page += 1;
        let number = inner.next_page;
        let mut snapshot = vec![self.machine.clone()];
        snapshot.push(ToPage::Program {
            program: inner.program.clone(),
        });
        snapshot.extend(inner.kept.clone());
        snapshot.extend(inner.macros.clone());
        snapshot.push(ToPage::Lease(inner.lease_of(number, role)));
        snapshot.push(ToPage::Log {
            entries: inner.log.entries(),
        });
        for message in &snapshot {
            // The channel is new and empty.
            let _sent = sender.try_send(text(message));
        }
        inner.pages.insert(
            number,
            Page {
                sender,
                session,
                role,
                client,
            },
        );
        Some((number, receiver))
    }

    /// Removes a page; returns whether it had control.
    pub(crate) fn leave(&self, number: u64) -> bool {
        let mut inner = self.lock();
        inner.pages.remove(&number);
        let had = inner.holder == Some(number);
        if had {
            inner.holder = None;
            inner.add_link(LogFact::ControlDisconnected { page: number });
            inner.tell_leases();
        }
        had
    }

    /// The control that a page has.
    pub(crate) fn term(&self, page: u64) -> Option<Term> {
        self.lock().term().filter(|term| term.page == page)
    }

    /// Whether a page has kept control since the start of the term.
    pub(crate) fn is_present(&self, term: Term) -> bool {
        self.lock().term() == Some(term)
    }

    /// The control of a page for a request outside its connection. All pages of a browser have one session,
    /// so the request names its page, and the session proves that the page belongs to this browser.
    pub(crate) fn term_of_request(&self, page: u64, session: &str) -> Option<Term> {
        let inner = self.lock();
        let term = inner.term().filter(|term| term.page == page)?;
        let holder = inner.pages.get(&page)?;
        (!session.is_empty() && holder.session == session).then_some(term)
    }

    /// Gives control to a page; returns whether another one lost it.
    pub(crate) fn take(&self, number: u64, force: bool) -> bool {
        let mut inner = self.lock();
        let before = inner.holder;
        let may = inner
            .pages
            .get(&number)
            .is_some_and(|page| page.role == Role::Operate);
        if !may || before == Some(number) || (before.is_some() && !force) {
            inner.tell_leases();
            return false;
        }
        inner.holder = Some(number);
        inner.terms += 1;
        inner.add_link(LogFact::ControlTaken {
            page: number,
            from: before,
        });
        inner.tell_leases();
        before.is_some()
    }

    /// Returns control; returns whether this page had it.
    pub(crate) fn give(&self, number: u64) -> bool {
        self.end_lease(number, LogFact::ControlReturned { page: number })
    }

    /// Takes control from a page that no longer sends; returns whether it had it.
    pub(crate) fn drop_silent(&self, number: u64) -> bool {
        self.end_lease(number, LogFact::ControlExpired { page: number })
    }

    fn end_lease(&self, number: u64, how: LogFact) -> bool {
        let mut inner = self.lock();
        let had = inner.holder == Some(number);
        if had {
            inner.holder = None;
            inner.add_link(how);
            inner.tell_leases();
        }
        had
    }

    /// Sends a message to one page; a page that does not read is dropped.
    pub(crate) fn tell_one(&self, number: u64, line: Utf8Bytes) {
        let mut inner = self.lock();
        let page = inner.pages.get(&number);
        if page.is_some_and(|page| page.sender.try_send(line).is_err()) {
            inner.pages.remove(&number);
        }
    }

    #[cfg(test)]
    pub(crate) fn log_entries(&self) -> Vec<crate::messages::LogEntry> {
        self.lock().log.entries()
    }

    pub(crate) fn log(&self, kind: LogKind, number: Option<u32>, text: String, cure: Option<String>) {
        self.lock().add(kind, number, text, cure);
    }

    /// Logs an entry of the server itself.
    pub(crate) fn log_fact(&self, kind: LogKind, number: Option<u32>, fact: LogFact, cure: Option<String>) {
        self.lock().add_fact(kind, number, fact, cure);
    }

    /// Logs a command that occurs many times in a row, such as jogs of a pad, once.
    pub(crate) fn log_repeated(&self, kind: LogKind, fact: LogFact) {
        let mut inner = self.lock();
        if let Some(entry) = inner.log.add_repeated(kind, fact) {
            inner.tell(&ToPage::Log { entries: vec![entry] });
        }
    }

    pub(crate) fn tell_program(&self, program: ProgramInfo) {
        let mut inner = self.lock();
        inner.beside = None;
        inner.put_program(program);
    }

    /// Shows an upload that the core has rejected; its errors are shown while the core still has `loaded`.
    pub(crate) fn tell_rejected(&self, program: ProgramInfo, loaded: String) {
        let mut inner = self.lock();
        inner.beside = Some(loaded);
        inner.put_program(program);
    }

    /// Shows a program in place of the one with number `before`; `false` if another one is already shown.
    pub(crate) fn replace_program(&self, before: Option<u64>, program: ProgramInfo) -> bool {
        let mut inner = self.lock();
        let is_before = inner.program.as_ref().map(|shown| shown.upload) == before;
        if is_before {
            inner.beside = None;
            inner.put_program(program);
        }
        is_before
    }

    /// The program that pages show and, if the core has rejected it, the program in the status at that time.
    pub(crate) fn shown_program(&self) -> (Option<ProgramInfo>, Option<String>) {
        let inner = self.lock();
        (inner.program.clone(), inner.beside.clone())
    }

    /// Reports the errors of a program, unless another one is loaded by now.
    pub(crate) fn tell_checked(&self, found: ProgramInfo) {
        let mut inner = self.lock();
        let present = inner.program.as_ref();
        if let Some(present) = present.filter(|present| present.upload == found.upload) {
            // It may have been planned before the check ended.
            let planned_s = present.planned_s;
            inner.put_program(ProgramInfo { planned_s, ..found });
        }
    }

    /// Adds the planned time of the loaded program.
    pub(crate) fn tell_planned(&self, name: &str, upload: u64, planned_s: Option<f64>) {
        let mut inner = self.lock();
        let is_it = |program: &ProgramInfo| {
            program.name == name && program.upload == upload && program.planned_s != planned_s
        };
        if let Some(program) = inner.program.clone().filter(is_it) {
            inner.put_program(ProgramInfo { planned_s, ..program });
        }
    }

    /// Sends the last message.
    pub(crate) fn tell_end(&self, what: EndOf) {
        self.lock().tell(&ToPage::End { what });
    }

    /// Sends the present macros.
    pub(crate) fn tell_macros(&self, macros: ToPage) {
        let mut inner = self.lock();
        inner.tell(&macros);
        inner.macros = Some(macros);
    }

    /// Sends offsets and tools if they have changed.
    pub(crate) fn tell_kept(&self, kept: ToPage) {
        let mut inner = self.lock();
        if inner.kept.as_ref() != Some(&kept) {
            inner.tell(&kept);
            inner.kept = Some(kept);
        }
    }
}

impl Inner {
    fn term(&self) -> Option<Term> {
        self.holder.map(|page| Term {
            page,
            number: self.terms,
        })
    }

    fn put_program(&mut self, program: ProgramInfo) {
        self.program = Some(program.clone());
        self.tell(&ToPage::Program {
            program: Some(program),
        });
    }

    /// Whether one more page of this client may watch. Many come through loopback, for example through a
    /// tunnel.
    fn may_watch(&self, client: IpAddr) -> bool {
        let watching = self.pages.values().filter(|page| page.role == Role::Watch);
        let (mut all, mut of_client) = (0, 0);
        for page in watching {
            all += 1;
            of_client += usize::from(page.client == client);
        }
        all < MAX_WATCHING && (client.is_loopback() || of_client < MAX_WATCHING_CLIENT)
    }

    fn lease_of(&self, number: u64, role: Role) -> Lease {
        Lease {
            mine: self.holder == Some(number),
            page: number,
            holder: self.holder,
            read_only: role == Role::Watch,
        }
    }

    fn tell_leases(&mut self) {
        let mut lost = Vec::new();
        for (&number, page) in &self.pages {
            let lease = ToPage::Lease(self.lease_of(number, page.role));
            if page.sender.try_send(text(&lease)).is_err() {
                lost.push(number);
            }
        }
        self.drop_pages(&lost);
    }

    /// A page whose channel is full has not read for a long time. It is dropped, which ends its connection.
    fn tell(&mut self, message: &ToPage) {
        let line = text(message);
        let failed =
            |(&number, page): (&u64, &Page)| page.sender.try_send(line.clone()).is_err().then_some(number);
        let lost: Vec<u64> = self.pages.iter().filter_map(failed).collect();
        self.drop_pages(&lost);
    }

    fn drop_pages(&mut self, lost: &[u64]) {
        for number in lost {
            self.pages.remove(number);
        }
    }

    fn add(&mut self, kind: LogKind, number: Option<u32>, text: String, cure: Option<String>) {
        let entry = self.log.add(kind, number, text, cure);
        self.tell(&ToPage::Log { entries: vec![entry] });
    }

    fn add_fact(&mut self, kind: LogKind, number: Option<u32>, fact: LogFact, cure: Option<String>) {
        let entry = self.log.add_fact(kind, number, fact, cure);
        self.tell(&ToPage::Log { entries: vec![entry] });
    }

    /// Logs an event of a page or of control.
    fn add_link(&mut self, fact: LogFact) {
        self.add_fact(LogKind::Link, None, fact, None);
    }
}

/// A message as JSON.
pub(crate) fn text(message: &ToPage) -> Utf8Bytes {
    // NaN and infinite values become null; nothing else in these types can fail.
    serde_json::to_string(message).unwrap_or_default().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn program(upload: u64, checked: bool, planned_s: Option<f64>) -> ProgramInfo {
        ProgramInfo {
            name: "part.ngc".to_owned(),
            upload,
            file: "part.ngc".to_owned(),
            problem: None,
            bytes: 7,
            errors: Vec::new(),
            warnings: Vec::new(),
            checked,
            planned_s,
        }
    }

    #[test]
    fn an_upload_belongs_to_the_page_in_control() {
        let hub = Hub::new(ToPage::Core { alive: false });
        let join = |session: &str| {
            hub.join(Visitor {
                session: session.to_owned(),
                role: Role::Operate,
                client: std::net::Ipv4Addr::LOCALHOST.into(),
            })
            .unwrap()
        };
        let ((first, _a), (second, _b), (other, _c)) = (join("one"), join("one"), join("two"));
        assert!(hub.term_of_request(first, "one").is_none(), "nobody has control");
        hub.take(first, false);
        let term = hub.term_of_request(first, "one").unwrap();
        assert!(hub.is_present(term));
        // Another tab of the browser, another browser, and a page's number with another session.
        for (page, session) in [(second, "one"), (other, "two"), (first, "two"), (first, "")] {
            assert!(hub.term_of_request(page, session).is_none(), "{page} {session}");
        }
        // The other tab takes control while the upload arrives.
        hub.take(second, true);
        assert!(!hub.is_present(term));
    }

    #[test]
    fn pages_that_watch_leave_some_for_those_that_operate() {
        let hub = Hub::new(ToPage::Core { alive: false });
        let join = |role, client: &str| {
            hub.join(Visitor {
                session: String::new(),
                role,
                client: client.parse().unwrap(),
            })
        };
        let mut pages = Vec::new();
        for client in ["192.0.2.1", "192.0.2.2"] {
            pages.extend((0..MAX_WATCHING_CLIENT).map(|_| join(Role::Watch, client).unwrap()));
            assert!(join(Role::Watch, client).is_none(), "{client}");
        }
        pages.extend((0..MAX_WATCHING_CLIENT).map(|_| join(Role::Watch, "127.0.0.1").unwrap()));
        assert_eq!(pages.len(), MAX_WATCHING);
        assert!(join(Role::Watch, "127.0.0.1").is_none());
        assert!(join(Role::Watch, "192.0.2.3").is_none());
        pages.extend((MAX_WATCHING..MAX_PAGES).map(|_| join(Role::Operate, "192.0.2.1").unwrap()));
        assert!(join(Role::Operate, "192.0.2.4").is_none());
        hub.leave(pages[0].0);
        assert!(join(Role::Watch, "192.0.2.1").is_some());
    }

    #[test]
    fn a_plan_before_its_check_keeps_its_time() {
        let hub = Hub::new(ToPage::Core { alive: false });
        let present = || hub.lock().program.clone();
        hub.tell_program(program(2, false, None));
        hub.tell_planned("part.ngc", 2, Some(12.5));
        hub.tell_checked(program(2, true, None));
        assert_eq!(present(), Some(program(2, true, Some(12.5))));
        // The same name and size again: late results of the former upload do not apply to it.
        hub.tell_program(program(3, false, None));
        hub.tell_planned("part.ngc", 2, Some(12.5));
        hub.tell_checked(program(2, true, None));
        assert_eq!(present(), Some(program(3, false, None)));
    }
}
