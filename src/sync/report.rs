//! The controller's own reports of its dwells.

use std::collections::BTreeMap;

use super::still::Stretch;
use super::stream::Stream;
use crate::units::HostNs;

/// The controller says that a dwell begins or ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// When the host heard it.
    pub host: HostNs,
    /// The plan's index.
    pub index: u32,
    /// 1 at the begin, 2 at the end.
    pub phase: u8,
}

/// The reported dwells by index, on the stream's clock; the last one of an index that was driven twice.
/// `None` when there are no reports or the device's clock cannot be set against the host's.
pub(super) fn stretches(reports: &[Report], stream: &Stream) -> Option<BTreeMap<u32, Stretch>> {
    /// Reports reach the host late, but before this, s.
    const LATE_S: f64 = 0.05;
    let mut dwells = BTreeMap::new();
    let mut open: Option<(u32, f64)> = None;
    for report in reports {
        let t_s = stream.time_of(report.host)?;
        match (report.phase, open) {
            (1, _) => open = Some((report.index, t_s)),
            (2, Some((index, start_s))) if index == report.index => {
                dwells.insert(index, Stretch { start_s, end_s: t_s - LATE_S, start_sd_s: LATE_S });
                open = None;
            }
            _ => {}
        }
    }
    (!dwells.is_empty()).then_some(dwells)
}
