//! The axes that a controller published during a run: order and losses of packets, and the track of the axes.

mod following;
mod order;
mod receiver;
mod track;

pub use following::{Following, SETTLED_DEG};
pub use order::{PacketOrder, Place};
pub use receiver::{AxesReceiver, AxesRecords, PacketCounts};
pub(crate) use track::LOSS_S;
pub use track::{AxisTrack, AxisTrackBuilder, Rest};
