//! A source whose reads take time on a clock that the test moves: real threads, virtual time.

use slicewalk::Result;
use slicewalk::bytes::{ByteSource, MemorySource};
use slicewalk::store::Stream;
use std::sync::{Condvar, Mutex};
use std::time::Duration;

#[derive(Debug, Default)]
struct Time {
    now_s: f64,
    /// End of the read in progress.
    ends_s: Option<f64>,
}

/// Bytes in memory. A prefetcher's read takes `read_s`; a caller that waits in a frame gets the bytes at once.
#[derive(Debug)]
pub struct ClockSource {
    bytes: MemorySource,
    read_s: f64,
    time: Mutex<Time>,
    moved: Condvar,
}

impl ClockSource {
    pub fn new(bytes: MemorySource, read_s: f64) -> Self {
        Self { bytes, read_s, time: Mutex::default(), moved: Condvar::new() }
    }

    /// Lets time pass until `until_s`. The stream's thread reads as much as it can meanwhile; its work between reads
    /// takes no virtual time, however long it takes on a busy machine.
    pub fn run(&self, stream: &Stream, until_s: f64) {
        loop {
            let ends = loop {
                let ends = self.time.lock().unwrap().ends_s;
                // The thread has reached its next read, or has nothing left to read.
                if ends.is_some() || stream.settle(Duration::from_micros(200)) {
                    break ends;
                }
            };
            let mut time = self.time.lock().unwrap();
            match ends.filter(|ends| *ends <= until_s) {
                Some(ends) => (time.now_s, time.ends_s) = (ends, None),
                None => {
                    time.now_s = until_s;
                    return;
                }
            }
            self.moved.notify_all();
        }
    }

    /// When the result is dropped, reads take no more time, so that a stream dropped later need not wait for a clock
    /// that has stopped.
    pub fn end(&self) -> impl Drop + '_ {
        struct End<'a>(&'a ClockSource);
        impl Drop for End<'_> {
            fn drop(&mut self) {
                let mut time = self.0.time.lock().unwrap();
                (time.now_s, time.ends_s) = (f64::INFINITY, None);
                self.0.moved.notify_all();
            }
        }
        End(self)
    }
}

impl ByteSource for ClockSource {
    fn len(&self) -> u64 {
        self.bytes.len()
    }

    fn read_at(&self, offset: u64, buf: &mut [u8]) -> Result<()> {
        let mut time = self.time.lock().unwrap();
        if self.read_s > 0.0
            && time.now_s < f64::INFINITY
            && std::thread::current().name() == Some("slicewalk-prefetch")
        {
            let ends_s = time.now_s + self.read_s;
            time.ends_s = Some(ends_s);
            while time.now_s < ends_s {
                time = self.moved.wait(time).unwrap();
            }
        }
        self.bytes.read_at(offset, buf)
    }
}
