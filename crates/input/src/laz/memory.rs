//! Memory that decoders hold for compressed chunks: a share each, and one turn for chunks that need more.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Limits of what decoders hold of chunks besides their batches (bytes). At most twice `most` is held at once.
#[derive(Debug)]
pub struct ChunkMemory {
    /// Limit of a chunk.
    most: u64,
    /// Limit of each decoder outside its turn.
    share: u64,
    /// Held by the decoder of a chunk that needs more than a share.
    turn: Mutex<()>,
}

/// Permission to decode a chunk, until it is dropped.
pub struct Permit<'a> {
    _turn: Option<MutexGuard<'a, ()>>,
}

impl ChunkMemory {
    /// Divides `most` bytes among `decoders`.
    pub fn new(most: u64, decoders: usize) -> Self {
        Self { most, share: most / decoders.max(1) as u64, turn: Mutex::default() }
    }

    /// Waits, if `bytes` exceed a share, until no other decoder holds more than its share. Fails with the limit if they
    /// exceed it.
    pub fn permit(&self, bytes: u64) -> Result<Permit<'_>, u64> {
        if bytes > self.most {
            return Err(self.most);
        }
        let wait = || self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Permit { _turn: (bytes > self.share).then(wait) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering::SeqCst};

    #[test]
    fn large_chunks_take_turns_and_small_ones_do_not_wait() {
        let memory = ChunkMemory::new(1000, 10);
        assert!(matches!(memory.permit(1001), Err(1000)));
        let _large = memory.permit(1000).unwrap();
        let _small = [memory.permit(100).unwrap(), memory.permit(0).unwrap()];
        assert!(memory.turn.try_lock().is_err());
        drop(_large);
        // The sum over all decoders stays below the sum of the shares and one large chunk.
        let (held, most) = (AtomicU64::new(0), AtomicU64::new(0));
        std::thread::scope(|scope| {
            for thread in 0..10u64 {
                let (memory, held, most) = (&memory, &held, &most);
                scope.spawn(move || {
                    for chunk in 0..200 {
                        let bytes = (thread * 71 + chunk * 37) % 1000;
                        let _permit = memory.permit(bytes).unwrap();
                        most.fetch_max(held.fetch_add(bytes, SeqCst) + bytes, SeqCst);
                        held.fetch_sub(bytes, SeqCst);
                    }
                });
            }
        });
        assert!(most.load(SeqCst) <= 2000, "{most:?}");
    }
}
