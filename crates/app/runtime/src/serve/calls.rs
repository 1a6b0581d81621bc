//! The order in which requests are answered: urgent ones overtake a command that waits for its files.

use std::collections::VecDeque;

use evolvent_bus::{ControlCall, ControlRequest};

use super::operator::Operator;

/// Maximum number of requests, of all clients, that wait for a command whose files are being read.
const MAX_WAITING: usize = 32;

/// Requests without an answer yet.
#[derive(Debug, Default)]
pub(super) struct Calls {
    /// Received, but not looked at yet.
    arrived: VecDeque<ControlCall>,
    /// The command whose files are being read.
    reading: Option<ControlCall>,
    waiting: VecDeque<ControlCall>,
}

impl Calls {
    pub(super) fn arrive(&mut self, call: ControlCall) {
        self.arrived.push_back(call);
    }

    pub(super) fn arrived(&self) -> usize {
        self.arrived.len()
    }

    /// Answers the requests received: first all of clients that stop the machine, then up to `max_answers` others.
    pub(super) fn answer_arrived(&mut self, operator: &mut Operator, now_ns: u64, max_answers: usize) {
        while let Some(client) = (self.arrived.iter())
            .find(|call| Operator::stops_machine(call.request()))
            .map(|call| call.request().client)
        {
            // The client's earlier requests come first, because its serial numbers increase.
            let is_same = |call: &ControlCall| call.request().client == client;
            if let Some(call) = (self.arrived.iter().position(is_same)).and_then(|at| self.arrived.remove(at))
            {
                self.take(call, operator, now_ns);
            }
        }
        for _ in 0..max_answers {
            let Some(call) = self.arrived.pop_front() else {
                break;
            };
            self.take(call, operator, now_ns);
        }
    }

    /// Answers a request, or keeps it until it can be answered.
    fn take(&mut self, call: ControlCall, operator: &mut Operator, now_ns: u64) {
        if self.reading.is_none() || Operator::is_urgent(call.request()) {
            self.ask(call, operator, now_ns);
            return;
        }
        // A client must wait for its answer before it sends the next command. One that does not is answered
        // at once, so that it cannot use up the capacity of others.
        let is_same = |other: &ControlCall| other.request().client == call.request().client;
        let is_crowded = self.waiting.len() >= MAX_WAITING
            || self.waiting.iter().any(is_same)
            || self.reading.as_ref().is_some_and(is_same);
        if is_crowded {
            let answer = operator.refuse_while_reading(call.request());
            call.answer(answer);
        } else {
            self.waiting.push_back(call);
        }
    }

    /// Answers the requests that have become ready since the last call.
    pub(super) fn go_on(&mut self, operator: &mut Operator, now_ns: u64) {
        loop {
            if self.reading.is_some() {
                let Some(answer) = operator.finish_reading(now_ns) else {
                    return;
                };
                if let Some(call) = self.reading.take() {
                    call.answer(answer);
                }
            }
            let Some(call) = self.waiting.pop_front() else {
                return;
            };
            self.ask(call, operator, now_ns);
        }
    }

    fn ask(&mut self, call: ControlCall, operator: &mut Operator, now_ns: u64) {
        let request: &ControlRequest = call.request();
        match operator.answer(request, now_ns) {
            Some(answer) => call.answer(answer),
            None => self.reading = Some(call),
        }
    }
}
