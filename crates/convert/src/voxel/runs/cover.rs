//! Coverage of runs: the part of the input that each run covers, so that another process can resume from them.

use super::put_varint;

/// Coverage of a run: pieces of the input's chunks.
#[derive(Debug, Default)]
pub(super) struct Cover {
    /// Encoded pieces. Each is its chunk, first point, number of points, the note of
    /// [`RunBuilder::covering`](super::RunBuilder::covering), and the result if it is the last piece of its chunk.
    /// Numbers are varints, byte strings follow their length.
    pub bytes: Vec<u8>,
    /// Points of all pieces.
    pub points: u64,
}

/// Appends the note of a piece.
pub(super) type Note = Box<dyn FnMut(&mut Vec<u8>) + Send>;

/// Collects the coverage of a builder's runs.
pub(super) struct Covering {
    note: Note,
    cover: Cover,
    chunk: u64,
    /// Points of the chunk covered by earlier pieces, and the points up to now.
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

    /// Begins a chunk: the points that follow are its points, from the first.
    pub fn begin(&mut self, chunk: u64) {
        (self.chunk, self.from, self.at) = (chunk, 0, 0);
    }

    /// Counts points of the chunk in the current run.
    pub fn add(&mut self, points: u64) {
        self.at += points;
    }

    /// Skips points of the chunk that other runs cover.
    pub fn pass(&mut self, points: u64) {
        self.close(None);
        self.at += points;
        self.from = self.at;
    }

    /// Returns the coverage of the current run and begins the next.
    pub fn take(&mut self) -> Cover {
        self.close(None);
        std::mem::take(&mut self.cover)
    }

    /// Length of the encoded coverage (bytes).
    pub fn len(&self) -> usize {
        self.cover.bytes.len()
    }

    /// Ends a piece; with a result, it is the last of its chunk.
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
