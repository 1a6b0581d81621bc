//! The planned path, in binary.

/// Bytes of a vertex.
pub const VERTEX_BYTES: usize = 21;

/// Vertices of the planned path. Little-endian: count (u32), x y z of all (f32, mm), feed of all (f32, mm/s, negative:
/// rapid), line of all (u32), what limits the motion of all (u8: a number of `Limiting` of `evolvent-analysis`).
#[derive(Clone, Debug, Default)]
pub struct PathChunk {
    position: Vec<[f32; 3]>,
    feed: Vec<f32>,
    line: Vec<u32>,
    limit: Vec<u8>,
}

impl PathChunk {
    /// Adds a vertex.
    pub fn push(&mut self, position: [f32; 3], feed: f32, line: u32, limit: u8) {
        self.limit.push(limit);
        self.position.push(position);
        self.feed.push(feed);
        self.line.push(line);
    }

    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.feed.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.feed.is_empty()
    }

    /// The bytes; it is empty afterwards.
    #[must_use]
    pub fn take_bytes(&mut self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(4 + self.len() * VERTEX_BYTES);
        bytes.extend((self.len() as u32).to_le_bytes());
        for value in self.position.drain(..).flatten().chain(self.feed.drain(..)) {
            bytes.extend(value.to_le_bytes());
        }
        for line in self.line.drain(..) {
            bytes.extend(line.to_le_bytes());
        }
        bytes.append(&mut self.limit);
        bytes
    }
}
