//! The path of a program, in binary.

/// Bytes of a chunk before its vertices.
pub const CHUNK_HEADER_BYTES: usize = 12;
/// Bytes of a vertex.
pub const VERTEX_BYTES: usize = 21;

/// What a chunk of the path shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum PathKind {
    /// The curves of the moves, with the feed of the program that the axes reach.
    Programmed = 0,
    /// The planned motion.
    Planned = 1,
}

/// Vertices of the path. Little-endian: count, kind and `replaced` (u32), x y z of all (f32, mm), feed of all
/// (f32, mm/s, negative: rapid), line of all (u32), what limits the motion of all (u8: a number of `Limiting`
/// of `evolvent-analysis`).
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

    /// The bytes; it is empty afterwards. `replaced`: number of vertices, from the first, of the programmed
    /// path that the planned path so far replaces; `u32::MAX` for all.
    #[must_use]
    pub fn take_bytes(&mut self, kind: PathKind, replaced: u32) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(CHUNK_HEADER_BYTES + self.len() * VERTEX_BYTES);
        for value in [self.len() as u32, kind as u32, replaced] {
            bytes.extend(value.to_le_bytes());
        }
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
