//! One line of the reports of `evolvent doctor`.

use std::io::{self, Write};

use evolvent_ethercat::{CardFinding, CardVerdict};
use evolvent_runtime::{Finding, Verdict};
use serde_json::{Value, json};

/// A finding of any part of the report.
pub(crate) struct FindingRow<'a> {
    name: &'a str,
    value: &'a str,
    /// good, fair or bad.
    verdict: &'static str,
    advice: Option<&'a str>,
}

impl<'a> From<&'a Finding> for FindingRow<'a> {
    fn from(finding: &'a Finding) -> Self {
        Self {
            name: finding.name,
            value: &finding.value,
            verdict: match finding.verdict {
                Verdict::Good => "good",
                Verdict::Fair => "fair",
                Verdict::Bad => "bad",
            },
            advice: finding.advice.as_deref(),
        }
    }
}

impl<'a> From<&'a CardFinding> for FindingRow<'a> {
    fn from(finding: &'a CardFinding) -> Self {
        Self {
            name: finding.name,
            value: &finding.value,
            verdict: match finding.verdict {
                CardVerdict::Good => "good",
                CardVerdict::Fair => "fair",
                CardVerdict::Bad => "bad",
            },
            advice: finding.advice.as_deref(),
        }
    }
}

impl FindingRow<'_> {
    pub(crate) fn to_json(&self) -> Value {
        json!({
            "name": self.name,
            "value": self.value,
            "verdict": self.verdict,
            "advice": self.advice,
        })
    }
}

/// Verdicts, names and values, in columns.
pub(crate) fn write_findings(rows: &[FindingRow<'_>], out: &mut dyn Write) -> io::Result<()> {
    let width = rows.iter().map(|row| row.name.len()).max().unwrap_or(0);
    for row in rows {
        writeln!(out, "{:<4}  {:<width$}  {}", row.verdict, row.name, row.value)?;
    }
    Ok(())
}

/// What to change, if anything.
pub(crate) fn write_advice(rows: &[FindingRow<'_>], out: &mut dyn Write) -> io::Result<()> {
    let mut advised = rows
        .iter()
        .filter_map(|row| Some((row.name, row.advice?)))
        .peekable();
    if advised.peek().is_some() {
        writeln!(out, "\nwhat to change:")?;
    }
    for (name, advice) in advised {
        writeln!(out, "  {name}: {advice}")?;
    }
    Ok(())
}
