//! The bar as a device, and the axes that a controller publishes: ports, and the protocols spoken on them.
//!
//! This crate must not know what is measured with the bar: no plan, no capture, no estimation. It has the only clock.
// A test names what it looks for.
#![cfg_attr(test, allow(clippy::wildcard_enum_match_arm))]

pub mod clock;
pub mod sync;

pub mod axes;
pub mod port;
pub mod protocol;

// Tests name this crate as its users do.
#[cfg(test)]
extern crate self as dbbd_device;
