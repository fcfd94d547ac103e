//! The bar as a device, and the axes that a controller publishes: ports, and the protocols spoken on them.

pub mod axes;
pub mod port;
pub mod protocol;
