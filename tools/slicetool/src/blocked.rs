//! Why no route connects two places, as JSON and in words.

use crate::ground::{Loader, tidy};
use crate::{Failure, Quiet};
use nalgebra::Point3;
use slicewalk::query::Answer;
use slicewalk::reach::{Obstruction, ObstructionSearch, Pawn, Reason, Sought};

/// The value of the key `blocked`.
pub fn to_json(found: &Obstruction) -> serde_json::Value {
    let [x, y, z] = [found.at.x, found.at.y, found.at.z].map(tidy);
    serde_json::json!({ "x": x, "y": y, "z": z, "reason": found.reason.name(), "needs": tidy(needs(found)) })
}

/// The value that passes, in the unit of the option: metres, or percent.
pub fn needs(found: &Obstruction) -> f64 {
    if found.reason == Reason::Slope { found.needs * 100.0 } else { found.needs }
}

/// A sentence about it. The value that it says passes does pass.
pub fn text(found: &Obstruction) -> String {
    let (at, needs) = (found.at, needs(found));
    let needs = rounded(found.reason, needs);
    let at = format!("{:.2},{:.2},{:.2}", at.x, at.y, at.z);
    match found.reason {
        Reason::Width => format!("too narrow at {at}; a pawn {needs:.2} m wide passes"),
        Reason::Length => format!("too long to pass or to turn at {at}; a pawn {needs:.2} m long passes"),
        Reason::Headroom => format!("too low at {at}; a pawn {needs:.2} m high passes"),
        Reason::Step => format!("a step too high at {at}; --climb {needs:.2} passes"),
        Reason::Slope => format!("too steep at {at}; --max-grade {needs:.1} passes"),
        Reason::Ramp => format!("a ramp too long without a landing at {at}; --max-ramp {needs:.1} passes"),
        Reason::Gap => format!("the ground ends at {at}, {needs:.2} m before what leads to the end"),
        _ => {
            format!("nothing was scanned or seen beyond {at}; the ground that leads to the end begins {needs:.2} m off")
        }
    }
}

/// The value as it is printed: a size of the pawn rounded down, what it can do rounded up.
fn rounded(reason: Reason, needs: f64) -> f64 {
    // Values that have no more digits stay what they are.
    let down = |scale: f64| (needs * scale + 1e-6).floor() / scale;
    let up = |scale: f64| (needs * scale - 1e-6).ceil() / scale;
    match reason {
        Reason::Width | Reason::Length | Reason::Headroom => down(100.0),
        Reason::Step => up(100.0),
        Reason::Slope | Reason::Ramp => up(10.0),
        _ => needs,
    }
}

/// Returns why a pawn, drawn out to `length` (m) if there is one, does not get from one place to the other.
pub fn blocked(
    loader: &Loader,
    pawn: &Pawn,
    length: Option<f64>,
    [from, to]: [Point3<f64>; 2],
) -> Result<Option<Obstruction>, Failure> {
    let mut search = ObstructionSearch::new(&loader.snapshot(), *pawn, from, to, &Quiet)?
        .within_seen(loader.seen().cloned())
        .drawn_out(length);
    // Each question by itself: over all of them, the pages of a place may be loaded many times.
    loop {
        let sought = loader.known(|view| {
            Ok(match search.advance(view)? {
                Sought::NotLoaded(missing) => Answer::NotLoaded(missing),
                sought => Answer::Known(sought),
            })
        })?;
        if let Sought::Done(found) = sought {
            return Ok(found);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::rounded;
    use slicewalk::reach::Reason;

    #[test]
    fn a_printed_value_passes() {
        assert_eq!([1.608594, 1.6].map(|needs| rounded(Reason::Headroom, needs)), [1.6, 1.6]);
        assert_eq!([0.694, 0.7].map(|needs| rounded(Reason::Width, needs)), [0.69, 0.7]);
        assert_eq!([1.242969, 0.35].map(|needs| rounded(Reason::Step, needs)), [1.25, 0.35]);
        assert_eq!([5.571289, 6.0].map(|needs| rounded(Reason::Slope, needs)), [5.6, 6.0]);
    }
}
