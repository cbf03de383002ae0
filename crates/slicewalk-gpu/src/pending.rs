//! Batches that the device has not answered yet.

use crate::device::Shared;
use crate::error::Result;
use crate::kinds::{Found, Question, Reply};
use crate::scene::Resident;
use slicewalk::store::Snapshot;
use std::future::poll_fn;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::task::{Poll, Waker};
#[cfg(not(target_family = "wasm"))]
use std::time::Duration;

/// Questions that were sent to a device.
#[must_use = "the answers are not collected"]
#[derive(Debug)]
pub struct Pending<'a, Q: Question> {
    pages: &'a Snapshot,
    resident: Option<&'a Resident>,
    questions: &'a [Q],
    pieces: Vec<Piece>,
}

/// Answers of a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct Replies<T> {
    /// Answers in the order of the questions.
    pub answers: Vec<Reply<T>>,
    /// Number of answers that the processor had to give: all without a device, else those that the device could not decide
    /// exactly.
    pub by_processor: usize,
}

/// Consecutive questions of a batch, sent together.
#[derive(Debug)]
pub(crate) struct Piece {
    copy: wgpu::Buffer,
    #[cfg_attr(target_family = "wasm", allow(dead_code, reason = "browsers wake the task"))]
    submission: wgpu::SubmissionIndex,
    mapped: Arc<(Mutex<Mapped>, Condvar)>,
    /// Numbers of the questions that the device did not get.
    left_out: Vec<u32>,
}

/// State of the answers' mapping.
#[derive(Debug, Default)]
struct Mapped {
    result: Option<Result<(), String>>,
    waker: Option<Waker>,
}

/// Longest time until a thread that polls the device has reported what it found.
#[cfg(not(target_family = "wasm"))]
const REPORTING: Duration = Duration::from_secs(60);

impl Piece {
    /// Begins to map the answers in `copy`.
    pub fn new(copy: wgpu::Buffer, submission: wgpu::SubmissionIndex, left_out: Vec<u32>) -> Self {
        let mapped = Arc::new((Mutex::new(Mapped::default()), Condvar::new()));
        let reported = mapped.clone();
        copy.slice(..).map_async(wgpu::MapMode::Read, move |result| {
            let (state, arrival) = &*reported;
            let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
            state.result = Some(result.map_err(|error| error.to_string()));
            arrival.notify_all();
            if let Some(waker) = state.waker.take() {
                waker.wake();
            }
        });
        Self { copy, submission, mapped, left_out }
    }

    /// Waits until the device has answered.
    #[cfg(not(target_family = "wasm"))]
    pub fn wait(&self, shared: &Shared) -> Result<()> {
        let until = wgpu::PollType::Wait { submission_index: Some(self.submission.clone()), timeout: None };
        shared.device.poll(until).map_err(|error| shared.failure(error))?;
        // Another thread may have polled first, and be about to report this piece.
        let (state, arrival) = &*self.mapped;
        let state = state.lock().unwrap_or_else(PoisonError::into_inner);
        drop(arrival.wait_timeout_while(state, REPORTING, |state| state.result.is_none()));
        Ok(())
    }

    /// Passes the words of the answers to `take`. Fails if they are not mapped.
    pub fn with_words<T>(&self, shared: &Shared, take: impl FnOnce(&[u32]) -> T) -> Result<T> {
        match self.result(None) {
            Some(Ok(())) => {}
            Some(Err(reason)) => return Err(shared.failure(reason)),
            None => return Err(shared.failure("the answers did not arrive")),
        }
        shared.check()?;
        let view = self.copy.slice(..).get_mapped_range().map_err(|error| shared.failure(error))?;
        let words =
            bytemuck::try_cast_slice(&view).map_err(|error| shared.failure(format!("mapped answers: {error}")))?;
        Ok(take(words))
    }

    fn result(&self, waker: Option<&Waker>) -> Option<Result<(), String>> {
        let mut mapped = self.mapped.0.lock().unwrap_or_else(PoisonError::into_inner);
        if mapped.result.is_none() {
            mapped.waker = waker.cloned();
        }
        mapped.result.clone()
    }
}

impl<'a, Q: Question> Pending<'a, Q> {
    pub(crate) fn on_processor(pages: &'a Snapshot, questions: &'a [Q]) -> Self {
        Self { pages, resident: None, questions, pieces: Vec::new() }
    }

    pub(crate) fn on_device(
        pages: &'a Snapshot,
        resident: &'a Resident,
        questions: &'a [Q],
        pieces: Vec<Piece>,
    ) -> Self {
        Self { pages, resident: Some(resident), questions, pieces }
    }

    /// Returns whether the device has answered, so that [`wait`](Self::wait) does not wait for it.
    pub fn is_ready(&self) -> bool {
        if let Some(resident) = self.resident {
            // A failure shows when the answers are collected.
            let _ = resident.device.shared.device.poll(wgpu::PollType::Poll);
        }
        self.pieces.iter().all(|piece| piece.result(None).is_some())
    }

    /// Waits for the answers and collects them. Fails, without any answer, if the device is lost or out of memory.
    #[cfg(not(target_family = "wasm"))]
    pub fn wait(self) -> Result<Replies<Q::Answer>> {
        let mut replies = Replies::with_capacity(self.questions.len());
        let Some(resident) = self.resident else { return Ok(self.ask_processor()) };
        let shared = &resident.device.shared;
        for (piece, questions) in self.pieces.into_iter().zip(self.questions.chunks(resident.piece::<Q>())) {
            piece.wait(shared)?;
            replies.collect(self.pages, resident, questions, &piece)?;
        }
        Ok(replies)
    }

    /// Waits for the answers without blocking the thread. Fails like [`wait`](Self::wait). Outside browsers, which wake
    /// the task, each poll of the future asks the driver and wakes its task again.
    pub async fn collect(self) -> Result<Replies<Q::Answer>> {
        let mut replies = Replies::with_capacity(self.questions.len());
        let Some(resident) = self.resident else { return Ok(self.ask_processor()) };
        let shared = &resident.device.shared;
        for (piece, questions) in self.pieces.into_iter().zip(self.questions.chunks(resident.piece::<Q>())) {
            poll_fn(|context| {
                let polled = shared.device.poll(wgpu::PollType::Poll);
                match (piece.result(Some(context.waker())), polled) {
                    (Some(_), _) => Poll::Ready(Ok(())),
                    (None, Err(error)) => Poll::Ready(Err(shared.failure(error))),
                    (None, Ok(_)) => {
                        if cfg!(not(target_family = "wasm")) {
                            context.waker().wake_by_ref();
                        }
                        Poll::Pending
                    }
                }
            })
            .await?;
            replies.collect(self.pages, resident, questions, &piece)?;
        }
        Ok(replies)
    }

    fn ask_processor(self) -> Replies<Q::Answer> {
        let answers = Q::ask_all(self.pages, self.questions);
        Replies { by_processor: answers.len(), answers }
    }
}

impl<T> Replies<T> {
    fn with_capacity(count: usize) -> Self {
        Self { answers: Vec::with_capacity(count), by_processor: 0 }
    }

    /// Appends the answers of a piece that is mapped, or whose mapping failed.
    fn collect<Q: Question<Answer = T>>(
        &mut self,
        pages: &Snapshot,
        resident: &Resident,
        questions: &[Q],
        piece: &Piece,
    ) -> Result<()> {
        let shared = &resident.device.shared;
        piece.with_words(shared, |words| {
            let mut left_out = piece.left_out.iter().copied().peekable();
            for ((number, question), words) in (0u32..).zip(questions).zip(words.chunks_exact(Q::ANSWER_WORDS)) {
                let found = match left_out.next_if_eq(&number) {
                    Some(_) => Found::Undecided,
                    None if words[0] == 0 => return Err(shared.failure("a question was not answered")),
                    None => question.decode(resident, pages, words),
                };
                self.answers.push(match found {
                    Found::Answer(answer) => answer,
                    Found::Undecided => {
                        self.by_processor += 1;
                        question.ask(pages)
                    }
                });
            }
            Ok(())
        })?
    }
}

/// Runs a future that completes on this thread.
#[cfg(not(target_family = "wasm"))]
pub(crate) fn wait_for<T>(future: impl Future<Output = T>) -> T {
    let mut future = std::pin::pin!(future);
    let mut context = std::task::Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(result) = future.as_mut().poll(&mut context) {
            return result;
        }
        std::thread::yield_now();
    }
}
