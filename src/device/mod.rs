//! The bar as a device: the port that it is on, and the protocol that it speaks.

pub mod port;
pub mod protocol;
