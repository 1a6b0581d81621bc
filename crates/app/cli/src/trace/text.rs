//! Common output of the commands of `evolvent trace`.

use std::io::{self, Write};

use serde_json::{Map, Value, json};

/// Lines of name and value, with the values aligned.
pub(super) fn write_table(out: &mut dyn Write, rows: &[(&str, String)]) -> io::Result<()> {
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    rows.iter()
        .try_for_each(|(name, value)| writeln!(out, "{name:width$}  {value}"))
}

pub(super) fn write_channels(
    out: &mut dyn Write,
    channels: &[evolvent_trace::ChannelInfo],
) -> io::Result<()> {
    let width = channels
        .iter()
        .map(|channel| channel.topic.len())
        .max()
        .unwrap_or(0);
    channels.iter().try_for_each(|channel| {
        writeln!(
            out,
            "{:width$}  {:>12} messages  {}",
            channel.topic, channel.messages, channel.message
        )
    })
}

pub(super) fn bytes(count: u64) -> String {
    let value = count as f64;
    match count {
        0..10_000 => format!("{count} bytes"),
        10_000..10_000_000 => format!("{:.1} kB", value / 1e3),
        10_000_000..10_000_000_000 => format!("{:.1} MB", value / 1e6),
        _ => format!("{:.2} GB", value / 1e9),
    }
}

pub(super) fn channels_to_json(channels: &[evolvent_trace::ChannelInfo]) -> Value {
    channels
        .iter()
        .map(|channel| {
            (
                channel.topic.clone(),
                json!({ "message": channel.message, "messages": channel.messages }),
            )
        })
        .collect::<Map<_, _>>()
        .into()
}

/// Converts texts that are numbers to numbers.
pub(super) fn map_to_json(map: &std::collections::BTreeMap<String, String>) -> Value {
    map.iter()
        .map(|(key, text)| {
            let number = text
                .parse::<i64>()
                .map(Value::from)
                .or_else(|_| text.parse::<u64>().map(Value::from))
                .or_else(|_| text.parse::<f64>().map(Value::from));
            // JSON has no infinity: it stays a string.
            let value = number.ok().filter(|value| !value.is_null());
            (key.clone(), value.unwrap_or_else(|| Value::from(text.clone())))
        })
        .collect::<Map<_, _>>()
        .into()
}
