//! Channels for general viewers: the tool and its path so far, a few times per second.

use crate::record::CycleRecord;
use crate::schema::{foxglove, timestamp};

/// The tool pose is written twenty times per second.
const POSE_SPAN_NS: u64 = 50_000_000;
/// The path has a point every 20 ms and is written every second.
const POINT_SPAN_NS: u64 = 20_000_000;
const PATH_POINTS: usize = 51;
/// Viewers draw in metres.
const METRES_PER_MM: f64 = 1e-3;
/// The coordinate frame of the pictures.
const FRAME: &str = "machine";

/// Derives pose and path from the cycles.
#[derive(Debug, Default)]
pub(crate) struct Scene {
    next_pose_ns: u64,
    next_point_ns: u64,
    points: Vec<[f64; 3]>,
    stretches: u64,
}

fn vector(position_mm: [f64; 3]) -> foxglove::Vector3 {
    let [x, y, z] = position_mm.map(|value| value * METRES_PER_MM);
    foxglove::Vector3 { x, y, z }
}

/// A pose of the tool, not turned. Position in mm.
pub(crate) fn pose(time_ns: u64, position_mm: [f64; 3]) -> foxglove::PoseInFrame {
    foxglove::PoseInFrame {
        timestamp: Some(timestamp(time_ns)),
        frame_id: FRAME.to_owned(),
        pose: Some(foxglove::Pose {
            position: Some(vector(position_mm)),
            orientation: Some(foxglove::Quaternion {
                x: 0.0,
                y: 0.0,
                z: 0.0,
                w: 1.0,
            }),
        }),
    }
}

impl Scene {
    /// The tool's pose, if it is time for one.
    pub(crate) fn pose(&mut self, record: &CycleRecord) -> Option<foxglove::PoseInFrame> {
        if record.due_time_ns < self.next_pose_ns {
            return None;
        }
        self.next_pose_ns = record.due_time_ns.saturating_add(POSE_SPAN_NS);
        Some(pose(
            record.due_time_ns,
            [record.position[0], record.position[1], record.position[2]],
        ))
    }

    /// Adds a point of the path; returns the path since the last time, if it is long enough.
    pub(crate) fn path(&mut self, record: &CycleRecord) -> Option<foxglove::SceneUpdate> {
        if record.due_time_ns < self.next_point_ns {
            return None;
        }
        self.next_point_ns = record.due_time_ns.saturating_add(POINT_SPAN_NS);
        self.points
            .push([record.position[0], record.position[1], record.position[2]]);
        (self.points.len() >= PATH_POINTS)
            .then(|| self.stretch(record.due_time_ns))
            .flatten()
    }

    /// The rest of the path, at the end.
    pub(crate) fn stretch(&mut self, time_ns: u64) -> Option<foxglove::SceneUpdate> {
        let last = *self.points.last()?;
        if self.points.len() < 2 {
            return None;
        }
        let line = foxglove::LinePrimitive {
            r#type: foxglove::line_primitive::Type::LineStrip as i32,
            pose: None,
            thickness: 2.0,
            scale_invariant: true,
            points: self
                .points
                .iter()
                .map(|&point| {
                    let foxglove::Vector3 { x, y, z } = vector(point);
                    foxglove::Point3 { x, y, z }
                })
                .collect(),
            color: Some(foxglove::Color {
                r: 0.1,
                g: 0.5,
                b: 0.9,
                a: 1.0,
            }),
        };
        // The next part starts where this one ends.
        self.points.clear();
        self.points.push(last);
        self.stretches += 1;
        Some(foxglove::SceneUpdate {
            entities: vec![foxglove::SceneEntity {
                timestamp: Some(timestamp(time_ns)),
                frame_id: FRAME.to_owned(),
                id: format!("path {}", self.stretches),
                lifetime: None,
                frame_locked: false,
                lines: vec![line],
            }],
        })
    }
}
