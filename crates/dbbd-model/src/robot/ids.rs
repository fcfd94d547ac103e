//! Typed indices, which users count from 1, and small types for the axes.

use std::fmt;
use std::num::{NonZeroU32, ParseIntError};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

macro_rules! numbered {
    ($($(#[$doc:meta])* $name:ident)+) => { $(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $name(NonZeroU32);

        impl $name {
            pub const FIRST: Self = Self(NonZeroU32::MIN);

            /// Makes the index from the number as it is written, from 1; `None` for 0.
            pub fn new(number: u32) -> Option<Self> {
                NonZeroU32::new(number).map(Self)
            }

            /// Makes the index from the place in a list, from 0.
            pub fn at(index: usize) -> Self {
                Self(NonZeroU32::MIN.saturating_add(u32::try_from(index).unwrap_or(u32::MAX)))
            }

            /// The number as it is written, from 1.
            pub fn number(self) -> u32 {
                self.0.get()
            }

            /// The index in a list.
            pub fn index(self) -> usize {
                self.0.get() as usize - 1
            }
        }

        impl FromStr for $name {
            type Err = ParseIntError;

            fn from_str(text: &str) -> Result<Self, ParseIntError> {
                text.parse().map(Self)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(out)
            }
        }
    )+ };
}

numbered! {
    /// A base ball.
    BallId
    /// A bar, or a length of it.
    BarId
    /// A target on the tool; the first is the tool ball.
    TargetId
    /// A circle of a plan.
    CircleId
    /// A payload on the flange, by its place in the list of the robot file; the first one is the default.
    PayloadId
}

/// The place from which a length is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Datum {
    /// A base ball, by a bar.
    Ball(BallId, BarId),
    /// A plane of the tracker's frame: the length is this coordinate of the target.
    Plane(Coordinate),
}

impl Datum {
    pub fn ball(self) -> Option<BallId> {
        match self {
            Self::Ball(ball, _) => Some(ball),
            Self::Plane(_) => None,
        }
    }

    pub fn bar(self) -> Option<BarId> {
        match self {
            Self::Ball(_, bar) => Some(bar),
            Self::Plane(_) => None,
        }
    }

    /// The length to another ball; a plane stays as it is.
    pub(crate) fn to_ball(self, ball: BallId) -> Self {
        self.bar().map_or(self, |bar| Self::Ball(ball, bar))
    }

    pub(crate) fn is_plane(self) -> bool {
        matches!(self, Self::Plane(_))
    }
}

/// A joint with its row of the DH table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Joint {
    J1,
    J2,
    J3,
    J4,
    J5,
    J6,
}

impl Joint {
    /// All joints, base to flange.
    pub const ALL: [Self; super::AXES] = [Self::J1, Self::J2, Self::J3, Self::J4, Self::J5, Self::J6];

    /// The joint with this number, from 1.
    pub fn new(number: usize) -> Option<Self> {
        Self::ALL.into_iter().find(|joint| joint.number() == number)
    }

    /// The number, from 1.
    pub fn number(self) -> usize {
        self.index() + 1
    }

    pub fn index(self) -> usize {
        self as usize
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Coordinate {
    X,
    Y,
    Z,
}

impl Coordinate {
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    pub fn index(self) -> usize {
        self as usize
    }
}

impl fmt::Display for Coordinate {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(["x", "y", "z"][self.index()])
    }
}

/// The largest difference of an axis, in the unit of the angles.
pub fn max_axis_difference(a: &[f64; super::AXES], b: &[f64; super::AXES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Axis angles of the controller, degrees as they were read.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct AxisAngles([f64; super::AXES]);

impl AxisAngles {
    pub fn from_degrees(degrees: [f64; super::AXES]) -> Self {
        Self(degrees)
    }

    pub fn degrees(&self) -> [f64; super::AXES] {
        self.0
    }

    pub fn degrees_mut(&mut self) -> &mut [f64; super::AXES] {
        &mut self.0
    }

    pub fn radians(&self) -> [f64; super::AXES] {
        self.0.map(f64::to_radians)
    }
}

/// The sense of the last move of each axis before a pose: -1, 1, or 0 if it is unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Approach([i8; super::AXES]);

impl Approach {
    pub fn new(senses: [i8; super::AXES]) -> Self {
        Self(senses.map(i8::signum))
    }

    pub fn senses(&self) -> [i8; super::AXES] {
        self.0
    }

    /// Whether no sense is known.
    pub(crate) fn is_unknown(&self) -> bool {
        *self == Self::default()
    }

    /// The approach of each pose (rad) of a sequence.
    pub fn along(axes: impl IntoIterator<Item = [f64; super::AXES]>) -> impl Iterator<Item = Self> {
        let (mut approach, mut last) = (Self::default(), None);
        axes.into_iter().map(move |axes| {
            if let Some(last) = &last {
                approach = approach.after(last, &axes);
            }
            last = Some(axes);
            approach
        })
    }

    /// The approach after a move between two poses (rad); an axis that does not move keeps its sense.
    pub fn after(self, from: &[f64; super::AXES], to: &[f64; super::AXES]) -> Self {
        Self(std::array::from_fn(|axis| match to[axis] - from[axis] {
            moved if moved > REST_RAD => 1,
            moved if moved < -REST_RAD => -1,
            _ => self.0[axis],
        }))
    }
}

/// Smallest move of an axis, rad.
const REST_RAD: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_start_at_one() {
        let ball = BallId::at(2);
        assert_eq!((ball.number(), ball.index(), ball.to_string()), (3, 2, "3".to_owned()));
        assert_eq!(serde_json::to_string(&ball).ok().as_deref(), Some("3"));
        assert_eq!(serde_json::from_str::<BallId>("3").ok(), Some(ball));
        assert!(BallId::new(0).is_none() && serde_json::from_str::<BallId>("0").is_err());
        assert_eq!(Joint::new(6), Some(Joint::J6));
        assert_eq!((Joint::new(0), Joint::new(7)), (None, None));
    }

    #[test]
    fn an_axis_keeps_its_sense_until_it_moves_again() {
        let poses = [
            [0.0; 6],
            [1.0, -1.0, 0.0, 0.0, 5e-10, 0.0],
            [1.0, -2.0, 1.0, 0.0, 0.0, 0.0],
            [0.5, -2.0, 1.0, 0.0, 0.0, 0.0],
        ];
        let approaches: Vec<[i8; 6]> = Approach::along(poses).map(|approach| approach.senses()).collect();
        assert_eq!(approaches, [[0; 6], [1, -1, 0, 0, 0, 0], [1, -1, 1, 0, 0, 0], [-1, -1, 1, 0, 0, 0]]);
        assert_eq!(Approach::new([5, -7, 0, 1, 0, 0]).senses(), [1, -1, 0, 1, 0, 0]);
        assert!(Approach::default().is_unknown() && !Approach::new([0, 0, 0, 0, 0, 1]).is_unknown());
    }

    #[test]
    fn a_datum_has_a_ball_and_a_bar_or_a_plane() {
        let length = Datum::Ball(BallId::at(2), BarId::at(1));
        assert_eq!(
            (length.ball(), length.bar(), length.is_plane()),
            (Some(BallId::at(2)), Some(BarId::at(1)), false)
        );
        let plane = Datum::Plane(Coordinate::Z);
        assert_eq!((plane.ball(), plane.bar(), plane.is_plane()), (None, None, true));
        assert_eq!(
            max_axis_difference(&[1.0, -2.0, 0.0, 0.0, 0.0, 3.0], &[0.5, 2.0, 0.0, 0.0, 0.0, 3.0]),
            4.0
        );
    }
}
