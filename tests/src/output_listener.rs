//! The outputs of a core as a reader of the bus sees them.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::MachineOutputs;

use crate::Domain;

/// Every message of outputs on the bus, from somebody who is no bridge.
#[derive(Debug)]
pub struct OutputListener {
    heard: Arc<Mutex<Vec<MachineOutputs>>>,
    over: Arc<AtomicBool>,
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
        let (heard, over) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let (its_ears, its_end) = (Arc::clone(&heard), Arc::clone(&over));
        let thread = std::thread::spawn(move || {
            let bus = evolvent_bus::ClientBus::open(&config).expect("the bus");
            let mut outputs = bus.outputs().expect("outputs");
            while !its_end.load(Ordering::Acquire) {
                while let Ok(Some(message)) = outputs.receive() {
                    its_ears.lock().expect("nobody panicked").push(message);
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        Self {
            heard,
            over,
            thread: Some(thread),
        }
    }

    /// What has been heard so far.
    #[must_use]
    pub fn messages(&self) -> Vec<MachineOutputs> {
        self.heard.lock().expect("nobody panicked").clone()
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
