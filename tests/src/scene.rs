//! A served mill with a folder and a domain of its own.

use std::path::PathBuf;

use crate::{Domain, Drives, Finished, Operator, Served, Workshop};

/// A mill that is served, without drives, until it is dropped.
#[derive(Debug)]
pub struct Scene {
    /// Its folder, with its state.
    pub workshop: Workshop,
    machine: PathBuf,
    name: String,
    /// None between an end and a restart.
    pub served: Option<Served>,
    /// Last: it checks that nothing is left of the others.
    pub domain: Domain,
}

impl Scene {
    /// Starts it under a name of its own.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self::with(name, &[])
    }

    /// The same with options of `evolvent serve`.
    #[must_use]
    pub fn with(name: &str, options: &[&str]) -> Self {
        Self::with_changes(name, &[], options)
    }

    /// The same with changes to the machine file, as of [`Workshop::mill`].
    #[must_use]
    pub fn with_changes(name: &str, changes: &[(&str, &str)], options: &[&str]) -> Self {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = workshop.mill(name, changes);
        let state = workshop.path("state");
        let served = Served::start(&machine, name, &domain, &state, options);
        Self {
            workshop,
            machine,
            name: name.to_owned(),
            served: Some(served),
            domain,
        }
    }

    /// The machine's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Simulated drives of it, in a process of their own.
    #[must_use]
    pub fn drives(&self, options: &[&str]) -> Drives {
        Drives::start(&self.machine, &self.domain, options)
    }

    /// Somebody who commands it.
    #[must_use]
    pub fn operator(&self) -> Operator {
        Operator::join(&self.name, &self.domain)
    }

    /// Starts it again, with the state that it had.
    pub fn restart(&mut self) {
        self.restart_with(&[]);
    }

    /// The same with options of `evolvent serve`.
    pub fn restart_with(&mut self, options: &[&str]) {
        let state = self.workshop.path("state");
        let served = Served::start(&self.machine, &self.name, &self.domain, &state, options);
        self.served = Some(served);
    }

    /// Ends it in order.
    ///
    /// # Panics
    /// It does not end so.
    pub fn end(self) {
        let _told = self.finish();
    }

    /// The same, and what it has told.
    ///
    /// # Panics
    /// It does not end so.
    #[must_use]
    pub fn finish(mut self) -> Finished {
        self.served.take().expect("a core").end().expect_code(&[0, 3])
    }
}
