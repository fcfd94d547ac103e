//! The axes that a controller published during a run: what came, in which order, and the track that it gives.

mod following;
mod order;
mod receiver;
mod rest;
mod track;

pub use following::{Following, SETTLED_DEG};
pub use order::{PacketOrder, Place};
pub use receiver::{AxesReceiver, AxesRecords, PacketCounts};
pub(crate) use rest::LOSS_S;
pub use rest::Rest;
pub use track::{AxisTrack, AxisTrackBuilder};
