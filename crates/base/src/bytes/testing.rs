//! Byte sources for tests: they count, delay, fail, or wait at a gate. Also inputs in memory, and a monitor that stops.

use super::ByteSource;
use crate::{Error, Monitor, Result};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Makes this thread read `bytes` for a scan, mesh or plan file called `path`, whatever files exist. Tests of millions
/// of inputs would otherwise spend their time in the file system.
pub fn hold(path: impl Into<PathBuf>, bytes: impl Into<Arc<[u8]>>) {
    super::hold_source(path, super::MemorySource::new(bytes));
}

/// One call among many, by number: what a test lets go wrong.
#[derive(Debug)]
pub struct Strike {
    number: u64,
    calls: AtomicU64,
}

impl Strike {
    /// Error text of what fails.
    pub const REASON: &str = "struck by the test";

    /// Chooses call `number`, counted from 0.
    pub fn at(number: u64) -> Arc<Self> {
        Arc::new(Self { number, calls: AtomicU64::new(0) })
    }

    /// Counts a call; returns whether it is the chosen one.
    pub fn hits(&self) -> bool {
        self.calls.fetch_add(1, Relaxed) == self.number
    }

    /// Returns whether the chosen call took place.
    pub fn fell(&self) -> bool {
        self.calls.load(Relaxed) > self.number
    }
}

/// As a monitor it cancels from the chosen question on.
impl Monitor for Strike {
    fn cancelled(&self) -> bool {
        self.hits() || self.fell()
    }
}

/// Source of which one read fails.
#[derive(Debug)]
pub struct StruckSource<S> {
    source: S,
    strike: Arc<Strike>,
}

impl<S> StruckSource<S> {
    /// Wraps `source`.
    pub fn new(source: S, strike: &Arc<Strike>) -> Self {
        Self { source, strike: strike.clone() }
    }
}

impl<S: ByteSource> ByteSource for StruckSource<S> {
    fn len(&self) -> u64 {
        self.source.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        if self.strike.hits() {
            let action = format!("read {} bytes at {offset}", buf.len());
            return Err(Error::io("struck source", action, std::io::Error::other(Strike::REASON)));
        }
        self.source.read_at(offset, buf)
    }
}

/// Source that counts reads and bytes, and sleeps before each read.
#[derive(Debug)]
pub struct SlowSource<S> {
    source: S,
    latency: Duration,
    reads: AtomicU64,
    bytes: AtomicU64,
}

impl<S> SlowSource<S> {
    /// Wraps `source` so that every read takes `latency` longer; with zero it only counts.
    pub fn new(source: S, latency: Duration) -> Self {
        Self { source, latency, reads: AtomicU64::new(0), bytes: AtomicU64::new(0) }
    }

    /// Returns the number of reads, and of the bytes they requested.
    pub fn counts(&self) -> (u64, u64) {
        (self.reads.load(Relaxed), self.bytes.load(Relaxed))
    }
}

impl<S: ByteSource> ByteSource for SlowSource<S> {
    fn len(&self) -> u64 {
        self.source.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        self.reads.fetch_add(1, Relaxed);
        self.bytes.fetch_add(buf.len() as u64, Relaxed);
        if !self.latency.is_zero() {
            std::thread::sleep(self.latency);
        }
        self.source.read_at(offset, buf)
    }
}

/// Effect of a [`FaultySource`] on reads that touch its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// No effect.
    None,
    /// Such reads fail.
    Fail,
    /// Such reads return wrong bytes.
    Flip,
}

/// Source that can be set to fail, or to return wrong bytes, for one range.
#[derive(Debug)]
pub struct FaultySource<S> {
    source: S,
    fault: Mutex<(Fault, std::ops::Range<u64>)>,
}

impl<S> FaultySource<S> {
    /// Wraps `source`, without a fault at first.
    pub fn new(source: S) -> Self {
        Self { source, fault: Mutex::new((Fault::None, 0..0)) }
    }

    /// Applies `fault` to all later reads that touch `bytes`.
    pub fn set(&self, fault: Fault, bytes: std::ops::Range<u64>) {
        *self.fault.lock().unwrap_or_else(PoisonError::into_inner) = (fault, bytes);
    }
}

impl<S: ByteSource> ByteSource for FaultySource<S> {
    fn len(&self) -> u64 {
        self.source.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        self.source.read_at(offset, buf)?;
        let (fault, bytes) = self.fault.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let end = offset + buf.len() as u64;
        let touched = bytes.start.max(offset)..bytes.end.min(end);
        match fault {
            _ if touched.is_empty() => Ok(()),
            Fault::None => Ok(()),
            Fault::Flip => {
                buf[(touched.start - offset) as usize] ^= 0x10;
                Ok(())
            }
            Fault::Fail => {
                let action = format!("read {} bytes at {offset}", buf.len());
                Err(Error::io("faulty source", action, std::io::ErrorKind::ConnectionReset.into()))
            }
        }
    }
}

/// Source whose reads pass while its gate is open and block while it is closed.
#[derive(Debug)]
pub struct GatedSource<S> {
    source: S,
    open: Mutex<bool>,
    changed: Condvar,
    waiting: AtomicBool,
}

impl<S> GatedSource<S> {
    /// Wraps `source` behind an open gate.
    pub fn new(source: S) -> Self {
        Self { source, open: Mutex::new(true), changed: Condvar::new(), waiting: AtomicBool::new(false) }
    }

    /// Opens or closes the gate.
    pub fn set_open(&self, open: bool) {
        *self.open.lock().unwrap_or_else(PoisonError::into_inner) = open;
        self.changed.notify_all();
    }

    /// Returns whether a read is waiting at the closed gate.
    pub fn is_waiting(&self) -> bool {
        self.waiting.load(Relaxed)
    }
}

impl<S: ByteSource> ByteSource for GatedSource<S> {
    fn len(&self) -> u64 {
        self.source.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        while !*open {
            self.waiting.store(true, Relaxed);
            open = self.changed.wait(open).unwrap_or_else(PoisonError::into_inner);
        }
        self.waiting.store(false, Relaxed);
        drop(open);
        self.source.read_at(offset, buf)
    }
}
