//! The controller's own reports of its dwells.

use std::collections::BTreeMap;
use std::ops::Range;

use super::dwell::Dwell;
use super::stream::Stream;
use crate::base::units::HostNs;
use crate::catalogue::MatchingFinding;
use crate::robot::AXES;

/// The controller reports that a dwell begins or ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// When it reached the host.
    pub host: HostNs,
    /// The plan's index.
    pub index: u32,
    /// 1 at the begin, 2 at the end.
    pub phase: u8,
    /// Axis angles that the controller measured then, degrees.
    pub axes_deg: [f64; AXES],
}

/// The measured axis angles of each reported dwell, degrees, by the plan's index: the mean of its begin and
/// its end, of the last time that it was driven.
pub fn reported_axes(reports: &[Report]) -> BTreeMap<u32, [f64; AXES]> {
    let mut axes: BTreeMap<u32, [f64; AXES]> = BTreeMap::new();
    let mut begin: Option<&Report> = None;
    for report in reports {
        let before = begin.filter(|before| report.phase == 2 && before.index == report.index);
        let mean = before.map_or(report.axes_deg, |before| {
            std::array::from_fn(|axis| 0.5 * (before.axes_deg[axis] + report.axes_deg[axis]))
        });
        axes.insert(report.index, mean);
        begin = (report.phase == 1).then_some(report);
    }
    axes
}

/// Reports reach the host late, but before this, s.
const LATE_S: f64 = 0.05;

/// Why the reports give no dwell, where there are some.
pub(super) fn unused(reports: &[Report], stream: &Stream) -> Option<MatchingFinding> {
    let first = reports.first()?;
    if spans(reports, stream).is_some() {
        return None;
    }
    let reports = reports.len();
    Some(match stream.time_of(first.host) {
        Some(_) => MatchingFinding::ReportsUnpaired { reports },
        None => MatchingFinding::ReportsOffPace { reports },
    })
}

/// From the report of its begin to that of its end, by index, s of the stream; the last one of an index that was
/// driven twice. `None` when there are no reports or the device's clock cannot be set against the host's.
pub(super) fn spans(reports: &[Report], stream: &Stream) -> Option<BTreeMap<u32, Range<f64>>> {
    let mut spans = BTreeMap::new();
    let mut open: Option<(u32, f64)> = None;
    for report in reports {
        let t_s = stream.time_of(report.host)?;
        match (report.phase, open) {
            (1, _) => open = Some((report.index, t_s)),
            (2, Some((index, start_s))) if index == report.index => {
                spans.insert(index, start_s..t_s);
                open = None;
            }
            _ => {}
        }
    }
    (!spans.is_empty()).then_some(spans)
}

/// The reported dwells, each as long as the robot surely stood.
pub(super) fn reported_dwells(reports: &[Report], stream: &Stream) -> Option<BTreeMap<u32, Dwell>> {
    let dwell = |span: Range<f64>| Dwell::whole(span.start, span.end - LATE_S, LATE_S);
    Some(spans(reports, stream)?.into_iter().map(|(index, span)| (index, dwell(span))).collect())
}
