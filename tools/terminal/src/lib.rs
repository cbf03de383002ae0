//! Terminal output of long work: progress, warnings, messages; and the signals that stop it.

use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use signal_hook::{consts, flag};
use slicewalk_base::text::{grouped, one_line};
use slicewalk_base::{Monitor, Parameter, Warning};
use std::io::Write as _;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Prints a line on standard error. Unlike `eprintln!`, it does not panic if the reader is gone.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{}", one_line(line));
}

/// Records in `signal` the signals that ask to stop. A second signal ends the process at once: temporary data vanish with
/// it or are removed by the next run.
pub fn listen(signal: &Arc<AtomicUsize>) -> std::io::Result<()> {
    let again = Arc::new(AtomicBool::new(false));
    let asking = [
        consts::SIGINT,
        consts::SIGTERM,
        #[cfg(unix)]
        consts::SIGHUP,
    ];
    for number in asking {
        flag::register_conditional_shutdown(number, 128 + number, again.clone())?;
        flag::register(number, again.clone())?;
        flag::register_usize(number, signal.clone(), number as usize)?;
    }
    Ok(())
}

/// Monitor that shows progress if standard error is a terminal, and always prints warnings there. The progress display
/// vanishes when this is dropped.
#[derive(Debug)]
pub struct Terminal {
    program: &'static str,
    quiet: bool,
    /// Returns the program's option for a parameter.
    option: fn(&Parameter) -> Option<&'static str>,
    /// Signal that asked to stop, or 0.
    signal: Arc<AtomicUsize>,
    bar: Mutex<ProgressBar>,
}

impl Terminal {
    /// Creates a monitor for `program`, whose name begins every line. `option` returns the option that warnings name
    /// for a parameter. Setting `signal` to the number of a signal stops the work.
    pub fn new(
        program: &'static str,
        quiet: bool,
        option: fn(&Parameter) -> Option<&'static str>,
        signal: Arc<AtomicUsize>,
    ) -> Self {
        Self { program, quiet, option, signal, bar: Mutex::new(ProgressBar::hidden()) }
    }

    fn bar(&self) -> MutexGuard<'_, ProgressBar> {
        self.bar.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.bar().finish_and_clear();
    }
}

impl Monitor for Terminal {
    fn stage(&self, name: &str, total: u64, unit: &str) {
        if self.quiet {
            return;
        }
        let bar = if total > 0 { ProgressBar::new(total) } else { ProgressBar::new_spinner() };
        if let Some(style) = style(total, unit) {
            bar.set_style(style);
        }
        bar.set_message(name.to_owned());
        std::mem::replace(&mut *self.bar(), bar).finish_and_clear();
    }

    fn advance(&self, amount: u64) {
        self.bar().inc(amount);
    }

    fn warn(&self, warning: &Warning) {
        if !self.quiet {
            let text = warning.render(self.option);
            self.bar().suspend(|| say(&format!("{}: warning: {text}", self.program)));
        }
    }

    fn cancelled(&self) -> bool {
        self.signal.load(Ordering::Relaxed) != 0
    }
}

/// Style of the progress line: `reading ━━━━━   1,234,567/20,000,000 points, 3,123,456/s, 1s passed, 6s left`
fn style(total: u64, unit: &str) -> Option<ProgressStyle> {
    let template = match total {
        0 => format!("{{msg}} {{spinner}} {{human_pos}} {unit}, {{rate}}/s, {{elapsed}} passed"),
        _ => format!(
            "{{msg}} {{wide_bar}} {{human_pos}}/{{human_len}} {unit}, {{rate}}/s, {{elapsed}} passed, {{eta}} left"
        ),
    };
    let rate = |state: &ProgressState, out: &mut dyn std::fmt::Write| {
        let _ = out.write_str(&grouped(state.per_sec() as u64));
    };
    Some(ProgressStyle::with_template(&template).ok()?.with_key("rate", rate))
}

#[cfg(test)]
mod tests {
    use super::*;
    use indicatif::{ProgressDrawTarget, TermLike};
    use std::fmt::Write as _;
    use std::io;

    /// Terminal, 120 columns wide, that records what is written to it.
    #[derive(Debug, Clone, Default)]
    struct Paper(Arc<Mutex<String>>);

    impl TermLike for Paper {
        fn width(&self) -> u16 {
            120
        }

        fn move_cursor_up(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_down(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_right(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn move_cursor_left(&self, _: usize) -> io::Result<()> {
            Ok(())
        }

        fn write_line(&self, line: &str) -> io::Result<()> {
            writeln!(self.0.lock().unwrap(), "{line}").map_err(io::Error::other)
        }

        fn write_str(&self, text: &str) -> io::Result<()> {
            self.0.lock().unwrap().write_str(text).map_err(io::Error::other)
        }

        fn clear_line(&self) -> io::Result<()> {
            Ok(())
        }

        fn flush(&self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn the_bar_groups_digits_and_labels_its_times() {
        let paper = Paper::default();
        let bar =
            ProgressBar::with_draw_target(Some(20_000_000), ProgressDrawTarget::term_like(Box::new(paper.clone())));
        bar.set_style(style(20_000_000, "points").unwrap());
        bar.set_message("reading");
        bar.set_position(1_234_567);
        bar.abandon();
        let text = paper.0.lock().unwrap().clone();
        let words = ["reading ", "1,234,567/20,000,000 points, ", "/s, ", " passed, ", " left"];
        assert!(words.iter().all(|words| text.contains(words)), "{text:?}");
        let rate = text.rsplit("points, ").next().and_then(|rest| rest.split("/s").next()).unwrap();
        assert!(rate.chars().all(|c| c.is_ascii_digit() || c == ','), "{rate:?}");
    }
}
