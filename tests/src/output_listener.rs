//! The outputs of a core as a reader of the bus sees them.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use evolvent_bus::MachineOutputs;

use crate::Domain;

/// Receives every message of outputs on the bus, without being a bridge. It also subscribes to setpoints,
/// after the outputs: a core that waits for one client more than its bridges then sends no change before the
/// listener receives it.
#[derive(Debug)]
pub struct OutputListener {
    messages: Arc<Mutex<Vec<MachineOutputs>>>,
    over: Arc<AtomicBool>,
    /// Number of requests by callers, and the last request before the thread last read the bus to its end.
    requested: Arc<AtomicU64>,
    completed: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl OutputListener {
    /// Listens to the core of this name until it is dropped.
    #[must_use]
    pub fn of(domain: &Domain, name: &str) -> Self {
        let config = evolvent_bus::ClientConfig {
            prefix: Some(domain.prefix.clone()),
            wait: Duration::from_secs(60),
            ..evolvent_bus::ClientConfig::new(name)
        };
        let (messages, over) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let (requested, completed) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let (received, ended) = (Arc::clone(&messages), Arc::clone(&over));
        let (request, completion) = (Arc::clone(&requested), Arc::clone(&completed));
        let thread = std::thread::spawn(move || {
            let bus = evolvent_bus::ClientBus::open(&config).expect("the bus");
            let mut outputs = bus.outputs().expect("outputs");
            let mut setpoints = bus.setpoints().expect("setpoints");
            while !ended.load(Ordering::Acquire) {
                let until = request.load(Ordering::Acquire);
                while let Ok(Some(_)) = setpoints.receive() {}
                while let Ok(Some(message)) = outputs.receive() {
                    received.lock().expect("nobody panicked").push(message);
                }
                completion.store(until, Ordering::Release);
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        Self {
            messages,
            over,
            requested,
            completed,
            thread: Some(thread),
        }
    }

    /// All messages sent before this call.
    ///
    /// # Panics
    /// If the listener has not read the bus within a minute: no core started, or the thread has failed.
    #[must_use]
    pub fn messages(&self) -> Vec<MachineOutputs> {
        let request = self.requested.fetch_add(1, Ordering::AcqRel) + 1;
        let begin = Instant::now();
        while self.completed.load(Ordering::Acquire) < request {
            assert!(
                begin.elapsed() < Duration::from_secs(60),
                "the listener does not read the bus"
            );
            std::thread::sleep(Duration::from_millis(1));
        }
        self.messages.lock().expect("nobody panicked").clone()
    }
}

impl Drop for OutputListener {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _panicked = thread.join();
        }
    }
}
