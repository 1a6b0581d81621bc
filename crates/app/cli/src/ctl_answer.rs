//! The answer to a command, as text or JSON.

use std::io::Write;

use evolvent_bus::{ControlAnswer, Status};
use evolvent_control::{Alarm, JobResult};
use serde_json::json;

use crate::{CommandError, Ending};

/// The machine state of an emergency stop.
const IN_ESTOP: u32 = 0;

/// The end of a job that was waited for.
pub(crate) struct JobEnd<'a> {
    pub(crate) status: &'a Status,
    /// This command stopped it on request, which is not a failure.
    pub(crate) by_own_stop: bool,
}

impl JobEnd<'_> {
    /// The reason why the job was not completed, if it was not.
    fn failure(&self, job: u64) -> Option<String> {
        let status = self.status;
        if job == 0 {
            return (status.alarm_count > 0).then(|| alarm_text(status)).flatten();
        }
        if status.job != job {
            return (!self.by_own_stop).then(|| {
                "another job has begun since, so that it is unknown how this one ended: `evolvent trace \
                 report` shows it"
                    .to_owned()
            });
        }
        let result = status.job_result;
        let is_stopped = result == JobResult::Stopped as u32;
        let is_fault = [JobResult::Failed as u32, JobResult::Fault as u32].contains(&result);
        if !is_fault && (!is_stopped || self.by_own_stop) {
            return None;
        }
        // An emergency stop by command is not an alarm; an open chain is one. A warning stops nothing.
        let is_estop = status.machine_state == IN_ESTOP;
        if ((is_fault && !is_estop) || has_latched_alarm(status))
            && let Some(text) = alarm_text(status)
        {
            return Some(text);
        }
        let text = if is_estop {
            "the machine was stopped by ESTOP; `evolvent ctl up` leaves the emergency stop and switches on"
        } else if is_stopped {
            "stopped before the end, by another client or because the core ends"
        } else {
            "the job ended early without an alarm: `evolvent ctl status` has the message"
        };
        Some(text.to_owned())
    }
}

/// Whether the newest alarms keep the machine from continuing; warnings do not.
pub(crate) fn has_latched_alarm(status: &Status) -> bool {
    status
        .listed_alarms()
        .iter()
        .any(|&number| Alarm::from_number(number).is_none_or(Alarm::is_latched))
}

/// The cause of the active alarms, with its number.
fn alarm_text(status: &Status) -> Option<String> {
    let number = status.listed_alarms().first().copied()?;
    let known = Alarm::from_number(number).map_or("", |alarm| alarm.sentence());
    let text = match status.alarm_sentence() {
        "" => known,
        text => text,
    };
    Some(format!("{text} ({number})"))
}

/// Prints the answer and, if it was waited for, the result of the job.
pub(crate) fn tell(
    answer: &ControlAnswer,
    end: Option<&JobEnd<'_>>,
    json: bool,
    out: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let accepted = answer.verdict == 0;
    let failure = end.and_then(|end| end.failure(answer.job));
    if json {
        let verdict = ["accepted", "rejected", "stale"];
        let results = ["none", "done", "stopped", "failed", "fault"];
        let status = end.map(|end| end.status);
        let result = status
            .filter(|status| status.job == answer.job)
            .and_then(|status| results.get(status.job_result as usize));
        let value = json!({
            "verdict": verdict.get(answer.verdict as usize),
            "alarm": (answer.alarm != 0).then_some(answer.alarm),
            "text": answer.text(),
            "sequence": answer.sequence,
            "job": (answer.job != 0).then_some(answer.job),
            "result": result,
            "failure": failure,
            "alarms": status.map(|status| status.listed_alarms().to_vec()).unwrap_or_default(),
            "alarm_text": status.map(|status| status.alarm_sentence().to_owned()),
        });
        writeln!(out, "{value}")
            .map_err(|error| CommandError::Failed(format!("the answer cannot be written: {error}")))?;
        return Ok(if accepted && failure.is_none() {
            Ending::Clean
        } else {
            Ending::Negative
        });
    }
    if !accepted {
        return Err(CommandError::Failed(format!(
            "{} ({})",
            answer.text(),
            answer.alarm
        )));
    }
    match failure {
        Some(text) => Err(CommandError::Failed(text)),
        None => Ok(Ending::Clean),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(job_result: JobResult, machine_state: u32, by_own_stop: bool) -> Result<Ending, String> {
        let answer = ControlAnswer {
            job: 7,
            ..ControlAnswer::default()
        };
        let status = Status {
            job: 7,
            job_result: job_result as u32,
            machine_state,
            ..Status::default()
        };
        let end = JobEnd {
            status: &status,
            by_own_stop,
        };
        tell(&answer, Some(&end), false, &mut Vec::new()).map_err(|error| format!("{error:?}"))
    }

    #[test]
    fn only_done_or_own_stop_counts_as_success() {
        assert!(outcome(JobResult::Done, 2, false).is_ok());
        assert!(outcome(JobResult::Stopped, 2, true).is_ok());
        let stopped = outcome(JobResult::Stopped, 2, false).unwrap_err();
        assert!(stopped.contains("stopped before the end"), "{stopped}");
        for result in [JobResult::Stopped, JobResult::Fault] {
            let estop = outcome(result, IN_ESTOP, false).unwrap_err();
            assert!(estop.contains("was stopped by ESTOP"), "{estop}");
        }
        assert!(outcome(JobResult::Fault, 2, true).is_err());
    }
}
