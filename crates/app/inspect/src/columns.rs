//! The contents of a trace as columns of a table.

use evolvent_path::AxisLetter;
use evolvent_trace::{BlockRecord, CycleRecord, EventRecord};

/// A column's values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Values {
    Double(Vec<f64>),
    Whole(Vec<i64>),
    Text(Vec<String>),
}

impl Values {
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Double(values) => values.len(),
            Self::Whole(values) => values.len(),
            Self::Text(values) => values.len(),
        }
    }

    fn clear(&mut self) {
        match self {
            Self::Double(values) => values.clear(),
            Self::Whole(values) => values.clear(),
            Self::Text(values) => values.clear(),
        }
    }
}

/// A column: its name with the unit, and some of its values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Column {
    pub(crate) name: String,
    pub(crate) values: Values,
}

/// Source of a column's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    Sequence,
    DueTime,
    Lateness,
    Work,
    Line,
    State,
    Flags,
    Inputs,
    Time,
    Path,
    Feed,
    Override,
    Load,
    Position(usize),
    Velocity(usize),
    Acceleration(usize),
    Jerk(usize),
    FollowingError(usize),
    DrivePosition(usize),
}

/// A table under construction.
#[derive(Debug)]
pub(crate) struct Table {
    pub(crate) columns: Vec<Column>,
    sources: Vec<Source>,
    start_time_ns: u64,
}

impl Table {
    /// Columns for cycles of a machine with these axes.
    pub(crate) fn of_cycles(axes: &[AxisLetter], start_time_ns: u64) -> Self {
        let mut list = vec![
            ("sequence".to_owned(), Source::Sequence),
            ("time_s".to_owned(), Source::Time),
            ("due_time_ns".to_owned(), Source::DueTime),
            ("line".to_owned(), Source::Line),
            ("state".to_owned(), Source::State),
            ("flags".to_owned(), Source::Flags),
            ("inputs".to_owned(), Source::Inputs),
            ("path_mm".to_owned(), Source::Path),
            ("feed_mm_s".to_owned(), Source::Feed),
            ("override".to_owned(), Source::Override),
        ];
        let unit = |axis: AxisLetter| if axis.is_rotary() { "deg" } else { "mm" };
        type Make = fn(usize) -> Source;
        let quantities: [(&str, &str, Make); 6] = [
            ("position", "", Source::Position),
            ("velocity", "_s", Source::Velocity),
            ("acceleration", "_s2", Source::Acceleration),
            ("jerk", "_s3", Source::Jerk),
            ("following_error", "", Source::FollowingError),
            ("drive_position", "", Source::DrivePosition),
        ];
        for (name, per, make) in quantities {
            for &axis in axes {
                let name = format!("{}_{name}_{}{per}", axis.letter(), unit(axis));
                list.push((name, make(axis.index())));
            }
        }
        list.extend([
            ("wake_lateness_ns".to_owned(), Source::Lateness),
            ("work_ns".to_owned(), Source::Work),
            ("load".to_owned(), Source::Load),
        ]);
        let columns = list
            .iter()
            .map(|(name, source)| Column {
                name: name.clone(),
                values: if source.is_whole() {
                    Values::Whole(Vec::new())
                } else {
                    Values::Double(Vec::new())
                },
            })
            .collect();
        Self {
            columns,
            sources: list.into_iter().map(|(_, source)| source).collect(),
            start_time_ns,
        }
    }

    /// Columns for events.
    pub(crate) fn of_events(start_time_ns: u64) -> Self {
        Self::plain(
            &["sequence", "time_s", "kind", "code", "value", "text"],
            &[false, true, false, false, true],
            start_time_ns,
        )
    }

    /// Columns for blocks.
    pub(crate) fn of_blocks(start_time_ns: u64) -> Self {
        let names = [
            "start_sequence",
            "end_time_s",
            "line",
            "kind",
            "length_mm",
            "planned_duration_s",
            "true_duration_s",
            "text",
        ];
        Self::plain(
            &names,
            &[false, true, false, false, true, true, true],
            start_time_ns,
        )
    }

    /// The last column is text, the others doubles or integers.
    fn plain(names: &[&str], doubles: &[bool], start_time_ns: u64) -> Self {
        let columns = names
            .iter()
            .enumerate()
            .map(|(at, name)| Column {
                name: (*name).to_owned(),
                values: match doubles.get(at) {
                    None => Values::Text(Vec::new()),
                    Some(true) => Values::Double(Vec::new()),
                    Some(false) => Values::Whole(Vec::new()),
                },
            })
            .collect();
        Self {
            columns,
            sources: Vec::new(),
            start_time_ns,
        }
    }

    pub(crate) fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| column.values.len())
    }

    pub(crate) fn clear(&mut self) {
        self.columns.iter_mut().for_each(|column| column.values.clear());
    }

    fn time_s(&self, time_ns: u64) -> f64 {
        // The difference is a whole number of ns, so it is exact before the single rounding.
        (i128::from(time_ns) - i128::from(self.start_time_ns)) as f64 * 1e-9
    }

    pub(crate) fn push_cycle(&mut self, record: &CycleRecord) {
        let time_s = self.time_s(record.due_time_ns);
        for (column, source) in self.columns.iter_mut().zip(&self.sources) {
            match &mut column.values {
                Values::Double(values) => values.push(source.double(record, time_s)),
                Values::Whole(values) => values.push(source.whole(record)),
                Values::Text(_) => {}
            }
        }
    }

    pub(crate) fn push_event(&mut self, record: &EventRecord) {
        let time_s = self.time_s(record.time_ns);
        let wholes = [record.sequence as i64, record.kind as i64, i64::from(record.code)];
        self.push_plain(&wholes, &[time_s, record.value.unwrap_or(f64::NAN)], &record.text);
    }

    pub(crate) fn push_block(&mut self, record: &BlockRecord) {
        let time_s = self.time_s(record.time_ns);
        let wholes = [
            record.start_sequence as i64,
            i64::from(record.line),
            record.kind as i64,
        ];
        let doubles = [
            time_s,
            record.length_mm,
            record.planned_duration_s,
            record.true_duration_s,
        ];
        self.push_plain(&wholes, &doubles, &record.text);
    }

    fn push_plain(&mut self, wholes: &[i64], doubles: &[f64], text: &str) {
        let (mut wholes, mut doubles) = (wholes.iter(), doubles.iter());
        for column in &mut self.columns {
            match &mut column.values {
                Values::Whole(values) => values.extend(wholes.next()),
                Values::Double(values) => values.extend(doubles.next()),
                Values::Text(values) => values.push(text.to_owned()),
            }
        }
    }
}

impl Source {
    const fn is_whole(self) -> bool {
        matches!(
            self,
            Self::Sequence
                | Self::DueTime
                | Self::Lateness
                | Self::Work
                | Self::Line
                | Self::State
                | Self::Flags
                | Self::Inputs
        )
    }

    #[inline]
    fn whole(self, record: &CycleRecord) -> i64 {
        match self {
            Self::Sequence => record.sequence as i64,
            Self::DueTime => record.due_time_ns as i64,
            Self::Lateness => record.wake_lateness_ns,
            Self::Work => i64::from(record.work_ns),
            Self::Line => i64::from(record.line),
            Self::State => i64::from(record.state),
            Self::Flags => i64::from(record.flags),
            Self::Inputs => i64::from(record.inputs),
            _ => 0,
        }
    }

    #[inline]
    fn double(self, record: &CycleRecord, time_s: f64) -> f64 {
        match self {
            Self::Time => time_s,
            Self::Path => record.path_mm,
            Self::Feed => record.feed_mm_s,
            Self::Override => record.override_,
            Self::Load => record.load,
            Self::Position(axis) => record.position[axis],
            Self::Velocity(axis) => record.velocity[axis],
            Self::Acceleration(axis) => record.acceleration[axis],
            Self::Jerk(axis) => record.jerk[axis],
            Self::FollowingError(axis) => record.following_error[axis],
            Self::DrivePosition(axis) => record.drive_position[axis],
            _ => f64::NAN,
        }
    }
}
