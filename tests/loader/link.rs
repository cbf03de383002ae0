//! A link with latency, rate and loss between a loader and an archive in memory, in virtual time: hours pass in
//! milliseconds.

use super::random::Random;
use slicewalk::store::{FetchId, Loader, Next, PageError};
use slicewalk::{Error, Result};
use std::ops::Range;
use std::time::Duration;

/// Treatment of answers.
#[derive(Debug, Clone, Copy)]
pub struct Manners {
    pub latency: Duration,
    /// Bytes per second.
    pub rate: f64,
    /// Percentage of answers that are failures.
    pub lost: u64,
    /// Whether answers come in any order instead of the requested one.
    pub shuffled: bool,
}

impl Manners {
    pub const GOOD: Self = Self { latency: Duration::from_millis(2), rate: 1e9, lost: 0, shuffled: false };
}

struct Answer {
    at: Duration,
    id: FetchId,
    range: Range<u64>,
}

pub struct Link<'a> {
    pub bytes: &'a [u8],
    pub manners: Manners,
    pub now: Duration,
    random: Random,
    free_at: Duration,
    on_the_way: Vec<Answer>,
    /// Everything exchanged between loader and link.
    pub transcript: Vec<String>,
    pub reports: Vec<PageError>,
    /// Bytes requested.
    pub asked: u64,
}

impl<'a> Link<'a> {
    pub fn new(bytes: &'a [u8], manners: Manners, seed: u64) -> Self {
        Self {
            bytes,
            manners,
            now: Duration::ZERO,
            random: Random(seed),
            free_at: Duration::ZERO,
            on_the_way: Vec::new(),
            transcript: Vec::new(),
            reports: Vec::new(),
            asked: 0,
        }
    }

    pub fn requests(&self) -> usize {
        self.transcript.iter().filter(|line| line.contains("fetch")).count()
    }

    fn note(&mut self, line: String) {
        self.transcript.push(format!("{:.4} {line}", self.now.as_secs_f64()));
    }

    /// Does everything that the loader demands until it waits; returns when it wants to be polled again.
    pub fn poll(&mut self, loader: &mut Loader) -> Result<Option<Duration>> {
        loop {
            match loader.poll(self.now)? {
                Next::Fetch(fetch) => {
                    self.note(format!("{:?} fetch {:?}", fetch.id, fetch.range));
                    self.asked += fetch.range.end - fetch.range.start;
                    let start = self.free_at.max(self.now + self.manners.latency);
                    let took =
                        Duration::from_secs_f64((fetch.range.end - fetch.range.start) as f64 / self.manners.rate);
                    self.free_at = start + took;
                    let late = Duration::from_millis(if self.manners.shuffled { self.random.below(300) } else { 0 });
                    self.on_the_way.push(Answer { at: self.free_at + late, id: fetch.id, range: fetch.range });
                }
                Next::Cancel(id) => {
                    self.note(format!("{id:?} cancel"));
                    // Half of the drivers cannot cancel a request in flight.
                    if self.random.below(2) == 0 {
                        self.on_the_way.retain(|answer| answer.id != id);
                    }
                }
                Next::Report(report) => {
                    self.note(format!("report {}", report.key));
                    self.reports.push(report);
                }
                Next::Wait(until) => return Ok(until),
            }
        }
    }

    /// Lets time pass until `until`; polls after every answer and whenever the loader asks for it.
    pub fn run(&mut self, loader: &mut Loader, until: Duration) -> Result<()> {
        loop {
            let again = self.poll(loader)?;
            let arrival = self.on_the_way.iter().map(|answer| answer.at).min();
            match [again, arrival].into_iter().flatten().min().filter(|next| *next <= until) {
                Some(next) => self.now = self.now.max(next),
                None => {
                    self.now = self.now.max(until);
                    return Ok(());
                }
            }
            self.deliver(loader);
        }
    }

    fn deliver(&mut self, loader: &mut Loader) {
        while let Some(n) = self.on_the_way.iter().position(|answer| answer.at <= self.now) {
            let answer = self.on_the_way.remove(n);
            if self.random.below(100) < self.manners.lost {
                self.note(format!("{:?} lost", answer.id));
                let lost = Error::io("link", "read", std::io::ErrorKind::ConnectionReset.into());
                loader.failed(answer.id, lost, self.now);
                continue;
            }
            let end = answer.range.end.min(self.bytes.len() as u64);
            let bytes = self.bytes[answer.range.start as usize..end as usize].to_vec();
            let job = loader.given(answer.id, bytes, self.now);
            let loaded = job.map(|job| loader.loaded(job.run(), self.now));
            self.note(format!("{:?} loaded {loaded:?}", answer.id));
        }
    }
}
