//! The answer to a command, as text or JSON.

use std::io::Write;

use evolvent_bus::{ControlAnswer, Status};
use evolvent_control::{Alarm, JobResult};
use serde_json::json;

use crate::{CommandError, Ending};

/// Prints the answer and, if it was waited for, the result of the job.
pub(crate) fn tell(
    answer: &ControlAnswer,
    end: Option<&Status>,
    json: bool,
    out: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let accepted = answer.verdict == 0;
    let result = end.map(|status| status.job_result);
    let is_bad = |status: &Status| {
        status.job == answer.job
            && [JobResult::Failed as u32, JobResult::Fault as u32].contains(&status.job_result)
    };
    let failed = end.is_some_and(|status| is_bad(status) || (answer.job == 0 && status.alarm_count > 0));
    if json {
        let verdict = ["accepted", "rejected", "stale"];
        let results = ["none", "done", "stopped", "failed", "fault"];
        let value = json!({
            "verdict": verdict.get(answer.verdict as usize),
            "alarm": (answer.alarm != 0).then_some(answer.alarm),
            "text": answer.text(),
            "sequence": answer.sequence,
            "job": (answer.job != 0).then_some(answer.job),
            "result": result.and_then(|result| results.get(result as usize)),
            "alarms": end.map(|status| status.listed_alarms().to_vec()).unwrap_or_default(),
            "alarm_text": end.map(|status| status.alarm_sentence().to_owned()),
        });
        writeln!(out, "{value}")
            .map_err(|error| CommandError::Failed(format!("the answer cannot be written: {error}")))?;
        return Ok(if accepted && !failed {
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
    if let Some(status) = end.filter(|_| failed) {
        let number = status.listed_alarms().last().copied().unwrap_or(0);
        let known = Alarm::from_number(number).map_or("", |alarm| alarm.sentence());
        let text = match status.alarm_sentence() {
            "" => known,
            text => text,
        };
        return Err(CommandError::Failed(format!("{text} ({number})")));
    }
    Ok(Ending::Clean)
}
