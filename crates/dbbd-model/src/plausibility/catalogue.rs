//! Values that are not plausible.

use super::{PlausibleRange, ValueKey};
use crate::findings;

findings! {
    /// A value that its quantity cannot have, or that no measurement gives.
    PlausibilityFinding "Plausible values" {
        E0130 "a value is not plausible",
        cause: "The number is outside of what its quantity can be: it is in another unit, a digit is missing or one too many, its sign is wrong, or it is not finite. With a mounted bar the feed has the limit of a controller's test mode (T1). A base ball is not in the robot's foot, nor beyond the reach of arm and bar.",
        cure: "Give the value in the unit that the message names. The unit of a key or a column is in its name. Put a ball where the bar reaches it." {
            Outside { key: ValueKey, value: f64, range: Box<PlausibleRange> } => "{key}{value} is not plausible: {range}";
            InOtherUnit { key: ValueKey, value: f64, range: Box<PlausibleRange>, meant: &'static str } => "{key}{value} is not plausible: {range}", help: "is it in {meant}?";
        }
        W0131 "measured values are not plausible",
        cause: "A column is in another unit than its name says, or its sensor was missing or faulty.",
        cure: "Convert the column, or leave it out. In place of a column of standard deviations one can be given for all lengths." {
            Unusual { key: ValueKey, value: f64, range: Box<PlausibleRange> } => "{key}{value} is not plausible: {range}";
            UnusualUnit { key: ValueKey, value: f64, range: Box<PlausibleRange>, meant: &'static str } => "{key}{value} is not plausible: {range}", help: "is it in {meant}?";
            AlwaysZero { key: ValueKey, range: Box<PlausibleRange> } => "{key}0 in every row: {range}", help: "is the sensor connected?";
        }
    }
}
