//! A served mill with its own folder and domain.

use std::path::PathBuf;

use crate::{Domain, Drives, Finished, Operator, Served, Workshop};

/// A mill that is served without drives until it is dropped.
#[derive(Debug)]
pub struct Scene {
    /// Its folder, with its state.
    pub workshop: Workshop,
    machine: PathBuf,
    name: String,
    /// `None` between an end and a restart.
    pub served: Option<Served>,
    /// The last field: its drop checks that the others leave nothing.
    pub domain: Domain,
}

impl Scene {
    /// Starts a mill with this name.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self::with(name, &[])
    }

    /// As [`Scene::new`], with options of `evolvent serve`.
    #[must_use]
    pub fn with(name: &str, options: &[&str]) -> Self {
        Self::with_changes(name, &[], options)
    }

    /// As [`Scene::with`], with changes to the machine file as for [`Workshop::mill`].
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

    /// The name of the machine.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Starts simulated drives for it, in their own process.
    #[must_use]
    pub fn drives(&self, options: &[&str]) -> Drives {
        Drives::start(&self.machine, &self.domain, options)
    }

    /// A client that commands it.
    #[must_use]
    pub fn operator(&self) -> Operator {
        Operator::join(&self.name, &self.domain)
    }

    /// Starts it again with its saved state.
    pub fn restart(&mut self) {
        self.restart_with(&[]);
    }

    /// As [`Scene::restart`], with options of `evolvent serve`.
    pub fn restart_with(&mut self, options: &[&str]) {
        let state = self.workshop.path("state");
        let served = Served::start(&self.machine, &self.name, &self.domain, &state, options);
        self.served = Some(served);
    }

    /// Ends it in order.
    ///
    /// # Panics
    /// If it does not end in order.
    pub fn end(self) {
        let _finished = self.finish();
    }

    /// As [`Scene::end`]; returns the output.
    ///
    /// # Panics
    /// If it does not end in order.
    #[must_use]
    pub fn finish(mut self) -> Finished {
        self.served.take().expect("a core").end().expect_code(&[0, 3])
    }
}
