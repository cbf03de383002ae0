//! What runs stand for, so that another process can go on from them.

use super::put_varint;

/// What a run stands for: pieces of the chunks of the input.
#[derive(Debug, Default)]
pub(super) struct Cover {
    /// One piece after the other: chunk, first point and number of points, what [`RunBuilder::covering`](super::RunBuilder::covering) notes, and the
    /// result if the piece is the last of its chunk; each number a varint, bytes behind their length.
    pub bytes: Vec<u8>,
    /// Points of all pieces.
    pub points: u64,
}

/// Appends what is to be noted of a chunk.
pub(super) type Note = Box<dyn FnMut(&mut Vec<u8>) + Send>;

/// Writes down what a builder's runs stand for.
pub(super) struct Covering {
    note: Note,
    cover: Cover,
    chunk: u64,
    /// Points of the chunk that earlier pieces stand for, and those so far.
    from: u64,
    at: u64,
}

impl std::fmt::Debug for Covering {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Covering(chunk {}, points {}..{})", self.chunk, self.from, self.at)
    }
}

impl Cover {
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }
}

impl Covering {
    pub fn new(note: Note) -> Self {
        Self { note, cover: Cover::default(), chunk: 0, from: 0, at: 0 }
    }

    /// The points that follow are those of this chunk, from its first.
    pub fn begin(&mut self, chunk: u64) {
        (self.chunk, self.from, self.at) = (chunk, 0, 0);
    }

    /// So many points of the chunk are in the run.
    pub fn add(&mut self, points: u64) {
        self.at += points;
    }

    /// So many points of the chunk are in other runs.
    pub fn pass(&mut self, points: u64) {
        self.close(None);
        self.at += points;
        self.from = self.at;
    }

    /// What the run stands for; the next one begins.
    pub fn take(&mut self) -> Cover {
        self.close(None);
        std::mem::take(&mut self.cover)
    }

    /// Length of what is written down (bytes).
    pub fn len(&self) -> usize {
        self.cover.bytes.len()
    }

    /// Ends a piece, which is the last of its chunk if there is a result.
    pub fn close(&mut self, result: Option<&[u8]>) {
        if self.from == self.at && result.is_none() {
            return;
        }
        let Self { note, cover: Cover { bytes, points }, chunk, from, at } = self;
        [*chunk, *from, *at - *from].into_iter().for_each(|number| put_varint(number, bytes));
        let mut noted = Vec::new();
        note(&mut noted);
        put_varint(noted.len() as u64, bytes);
        bytes.extend(noted);
        put_varint(result.map_or(0, |result| 1 + result.len() as u64), bytes);
        bytes.extend(result.unwrap_or_default());
        *points += *at - *from;
        *from = *at;
    }
}
