//! Messages between the engine and JavaScript, defined once: structures whose fields pass as numbers in this order.
//!
//! `package/src/messages.ts` has the same structures in TypeScript. A test writes that file anew and fails if it
//! differs from the one in the tree; with `SLICEWALK_WRITE_MESSAGES=1` it replaces it.

/// Defines structures of numbers, and for the test their TypeScript.
macro_rules! messages {
    ($($(#[doc = $doc:literal])* $name:ident { $($(#[doc = $what:literal])* $field:ident,)* })*) => {
        $(
            $(#[doc = $doc])*
            #[derive(Debug, Clone, Copy, PartialEq)]
            pub struct $name {
                $($(#[doc = $what])* pub $field: f64,)*
            }

            #[allow(dead_code)] // some only go out, others only come in
            impl $name {
                /// Number of fields.
                pub const LEN: usize = [$(stringify!($field)),*].len();

                /// Returns the fields in order.
                pub fn numbers(&self) -> [f64; Self::LEN] {
                    [$(self.$field),*]
                }

                /// Reads the fields in order; `None` unless there are as many numbers.
                pub fn from_numbers(numbers: &[f64]) -> Option<Self> {
                    let &[$($field),*] = numbers else { return None };
                    Some(Self { $($field),* })
                }
            }
        )*

        #[cfg(test)]
        const MESSAGES: &[Defined] =
            &[$((stringify!($name), concat!($($doc),*), &[$((stringify!($field), concat!($($what),*))),*])),*];
    };
}

/// Defines enumerations that pass as the number of their variant.
macro_rules! codes {
    ($($(#[doc = $doc:literal])* $name:ident { $($(#[doc = $what:literal])* $variant:ident,)* })*) => {
        $(
            $(#[doc = $doc])*
            #[derive(Debug, Clone, Copy, PartialEq, Eq)]
            pub enum $name {
                $($(#[doc = $what])* $variant,)*
            }

            impl From<$name> for f64 {
                fn from(code: $name) -> f64 {
                    f64::from(code as u8)
                }
            }
        )*

        #[cfg(test)]
        const CODES: &[Defined] =
            &[$((stringify!($name), concat!($($doc),*), &[$((stringify!($variant), concat!($($what),*))),*])),*];
    };
}

/// Name, comment, and the names and comments of fields or variants.
#[cfg(test)]
type Defined = (&'static str, &'static str, &'static [(&'static str, &'static str)]);

messages! {
    /// Shape and abilities of a pawn (m, s).
    SettingsMessage {
        /// 0 box, 1 cylinder.
        shape,
        /// Edge along x, or the radius.
        x,
        /// Edge along y.
        y,
        /// Height of the body.
        height,
        /// Highest step.
        climb,
        /// Walking speed.
        speed,
        /// Acceleration downwards.
        gravity,
        /// Height of a jump.
        jump,
        /// Height while crouching.
        crouch,
        /// Deepest drop that the pawn walks over; NaN: any.
        max_drop,
    }
    /// Input of a pawn for the time of a step.
    InputMessage {
        /// Direction, or the place to walk to: x.
        x,
        /// Direction, or the place to walk to: y.
        y,
        /// Factor of the walking speed.
        pace,
        /// Up or down while flying, -1 to 1.
        lift,
        /// 1 jump, 2 crouch, 4 fly, 8 walk to the place, 32 along the route.
        flags,
    }
    /// State of a pawn (m, m/s).
    StateMessage {
        /// Feet: x.
        x,
        /// Feet: y.
        y,
        /// Feet: z.
        z,
        /// Number of a `GroundCode`.
        ground,
        /// Number of a `StopCode`.
        stop,
        /// Horizontal speed over the last step.
        speed,
        /// Upward speed over the last step.
        rise,
        /// 1 if it crouches.
        crouched,
        /// Height of the body now.
        height,
        /// Pages that the last step waited for.
        missing,
        /// Ticks that passed.
        ticks,
        /// Steps answered.
        steps,
        /// Places of its route that lie ahead.
        ahead,
    }
    /// State of a crowd.
    CrowdMessage {
        /// Pages that the last step waited for.
        missing,
    }
    /// State of a walker of a crowd (m).
    MemberMessage {
        /// Feet: x.
        x,
        /// Feet: y.
        y,
        /// Feet: z.
        z,
        /// Number of a `MemberCode`.
        activity,
    }
    /// Outcome of a move along surfaces (m).
    SlideMessage {
        /// Way moved: x.
        x,
        /// Way moved: y.
        y,
        /// Way moved: z.
        z,
        /// 1 if pages are missing ahead.
        missing,
    }
    /// Contact of a move.
    ContactMessage {
        /// Way until the contact (m).
        distance,
        /// Outward normal of the surface: x.
        normal_x,
        /// Outward normal of the surface: y.
        normal_y,
        /// Outward normal of the surface: z.
        normal_z,
        /// 1 if it is an obstacle.
        obstacle,
    }
    /// Memory and work of the engine.
    StatsMessage {
        /// Pages in memory.
        resident_pages,
        /// Their bytes.
        resident_bytes,
        /// Bytes of the budget in use.
        used_bytes,
        /// Most bytes in use so far.
        peak_bytes,
        /// The budget.
        budget_bytes,
        /// Pages loaded so far.
        loaded,
        /// Pages evicted so far.
        evicted,
        /// Pages that walkers wait for.
        missing,
        /// Pages whose geometry is not built yet.
        unbuilt,
    }
    /// What the worker has to do next.
    ActionMessage {
        /// Number of an `ActionCode`.
        action,
        /// Name of the fetch.
        fetch,
        /// First byte; of `Wait`: milliseconds until the next poll, Infinity: after an event.
        start,
        /// End of the bytes.
        end,
    }
    /// Head of a built page (m).
    PageMessage {
        /// Name of the page in its view.
        page,
        /// Tile column: x.
        tx,
        /// Tile column: y.
        ty,
        /// Layer of slices.
        layer,
        /// Place of position zero: x.
        x,
        /// Place of position zero: y.
        y,
        /// Place of position zero: z.
        z,
        /// Length of a unit of the positions: x.
        scale_x,
        /// Length of a unit of the positions: y.
        scale_y,
        /// Length of a unit of the positions: z.
        scale_z,
        /// Lowest corner of the solid: x.
        min_x,
        /// Lowest corner of the solid: y.
        min_y,
        /// Lowest corner of the solid: z.
        min_z,
        /// Highest corner of the solid: x.
        max_x,
        /// Highest corner of the solid: y.
        max_y,
        /// Highest corner of the solid: z.
        max_z,
        /// 0, or the overview level.
        level,
    }
    /// Head of the colours of a page.
    PaintMessage {
        /// Name of the view.
        view,
        /// Name of the page in it.
        page,
        /// Cells along an edge.
        edge,
    }
}

codes! {
    /// What a pawn does.
    GroundCode {
        /// Stands or walks.
        Walking,
        /// Is in the air.
        Falling,
        /// Cannot go on.
        Blocked,
        /// Flies.
        Flying,
    }
    /// Activity of a walker of a crowd.
    MemberCode {
        /// Stands or walks.
        Walking,
        /// Is in the air.
        Falling,
        /// Cannot go on.
        Blocked,
        /// Is at its goal, or as near as others let it.
        Arrived,
    }
    /// What blocked a pawn.
    StopCode {
        /// Nothing did.
        None,
        /// A wall, or a step that is too high.
        Wall,
        /// A slope.
        Steep,
        /// A ceiling.
        Headroom,
        /// A corner.
        Corner,
        /// Solid around the pawn.
        Inside,
        /// A drop.
        Ledge,
        /// Nothing was scanned below.
        Void,
    }
    /// State of a route.
    RouteCode {
        /// It was found.
        Found,
        /// It is not found yet.
        Unfinished,
        /// It needs pages, which are requested.
        NotLoaded,
        /// The pawn cannot stand at the start.
        NotStandingFrom,
        /// The pawn cannot stand at the end.
        NotStandingTo,
        /// No route connects the two.
        NotConnected,
        /// The search was given up.
        TooFar,
    }
    /// Actions of the worker.
    ActionCode {
        /// Poll again after some time.
        Wait,
        /// Fetch bytes.
        Fetch,
        /// Cancel a fetch.
        Cancel,
        /// Fetch bytes of colours.
        FetchColours,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;

    fn camel(name: &str) -> String {
        let mut words = name.split('_');
        let first = words.next().unwrap_or_default().to_string();
        words.fold(first, |all, word| format!("{all}{}{}", word[..1].to_uppercase(), &word[1..]))
    }

    /// `FetchColours` → `fetch-colours`.
    fn kebab(name: &str) -> String {
        let small = name.chars().map(|c| if c.is_uppercase() { format!("-{}", c.to_lowercase()) } else { c.into() });
        small.collect::<String>().trim_start_matches('-').into()
    }

    fn comment(text: &str, indent: &str) -> String {
        format!("{indent}/** {} */\n", text.trim())
    }

    fn typescript() -> String {
        let mut out = String::from(
            "// Written by a test of the engine (engine/src/messages.rs), which defines these messages; do not edit.\n",
        );
        for (name, what, variants) in CODES {
            let list: Vec<String> = variants.iter().map(|(variant, _)| format!("\"{}\"", kebab(variant))).collect();
            let table = kebab(name).replace('-', "_").to_uppercase();
            write!(out, "\n{}export const {table} = [{}] as const;\n", comment(what, ""), list.join(", ")).unwrap();
        }
        for (name, what, fields) in MESSAGES {
            write!(out, "\n{}export interface {name} {{\n", comment(what, "")).unwrap();
            for (field, what) in *fields {
                writeln!(out, "{}  readonly {}: number;", comment(what, "  "), camel(field)).unwrap();
            }
            let short = name.trim_end_matches("Message");
            write!(
                out,
                "}}\n\nexport function read{short}(numbers: ArrayLike<number>, at = 0): {name} {{\n  return {{\n"
            )
            .unwrap();
            for (n, (field, _)) in fields.iter().enumerate() {
                let place = if n == 0 { "at".into() } else { format!("at + {n}") };
                writeln!(out, "    {}: numbers[{place}] ?? 0,", camel(field)).unwrap();
            }
            write!(out, "  }};\n}}\n\nexport function write{short}(message: {name}): number[] {{\n  return [\n")
                .unwrap();
            for (field, _) in *fields {
                writeln!(out, "    message.{},", camel(field)).unwrap();
            }
            write!(
                out,
                "  ];\n}}\n\n/** Numbers of a `{name}`. */\nexport const {}_LENGTH = {};\n",
                short.to_uppercase(),
                fields.len()
            )
            .unwrap();
        }
        out
    }

    #[test]
    fn the_package_has_the_same_messages() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../package/src/messages.ts");
        if std::env::var_os("SLICEWALK_WRITE_MESSAGES").is_some() {
            std::fs::write(path, typescript()).unwrap();
        }
        let found = std::fs::read_to_string(path).unwrap_or_default();
        assert!(found == typescript(), "{path} is not current: run this test with SLICEWALK_WRITE_MESSAGES=1");
    }

    #[test]
    fn messages_keep_their_fields() {
        let numbers: Vec<f64> = (0..StateMessage::LEN).map(|n| n as f64).collect();
        let state = StateMessage::from_numbers(&numbers).unwrap();
        assert_eq!((state.z, state.missing, state.numbers().to_vec()), (2.0, 9.0, numbers.clone()));
        assert_eq!(StateMessage::from_numbers(&numbers[1..]), None);
        assert_eq!(f64::from(ActionCode::FetchColours), 3.0);
    }
}
