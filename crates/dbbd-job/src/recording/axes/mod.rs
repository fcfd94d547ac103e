//! The axes that a controller published during a run: order and losses of packets, and the track of the axes.

mod following;
mod order;
mod receiver;
mod track;

pub use following::{FollowingError, SETTLED_DEG};
pub use order::{PacketOrder, PacketPlace};
pub use receiver::{AxesReceiver, AxesRecords, PacketCounts};
pub(crate) use track::LOSS_S;
pub use track::{AxisTrack, AxisTrackBuilder, ExternalMotion, RestInterval};
