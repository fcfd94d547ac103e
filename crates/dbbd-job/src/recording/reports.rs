//! The controller's reports of its dwells.

use std::collections::BTreeMap;
use std::ops::Range;

use super::dwell::Dwell;
use super::stream::SampleStream;
use crate::recording::matching::MatchingFinding;
use dbbd_model::base::units::HostNs;
use dbbd_model::robot::AXES;

/// The controller's report that a dwell begins or ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DwellReport {
    /// Arrival at the host.
    pub host: HostNs,
    /// Index of the pose in the plan.
    pub index: u32,
    /// 1 at the start of the dwell, 2 at its end.
    pub phase: u8,
    /// Axis angles measured at that moment, degrees.
    pub axes_deg: [f64; AXES],
}

/// The reports of start and end of each dwell that has both, by index. If a pose was driven twice, the last such dwell
/// counts.
fn pairs(reports: &[DwellReport]) -> BTreeMap<u32, [&DwellReport; 2]> {
    let mut pairs = BTreeMap::new();
    let mut open: Option<&DwellReport> = None;
    for report in reports {
        match (report.phase, open) {
            (1, _) => open = Some(report),
            (2, Some(start)) if start.index == report.index => {
                pairs.insert(report.index, [start, report]);
                open = None;
            }
            _ => {}
        }
    }
    pairs
}

/// Measured axis angles of each reported dwell, degrees, by index: the mean of start and end. Of a dwell without such a pair
/// the last report counts.
pub fn reported_axes(reports: &[DwellReport]) -> BTreeMap<u32, [f64; AXES]> {
    let lone = reports.iter().map(|report| (report.index, report.axes_deg));
    let mean = |[start, end]: [&DwellReport; 2]| {
        std::array::from_fn(|axis| 0.5 * (start.axes_deg[axis] + end.axes_deg[axis]))
    };
    lone.chain(pairs(reports).into_iter().map(|(index, pair)| (index, mean(pair)))).collect()
}

/// Largest delay of a report, s.
const LATE_S: f64 = 0.05;

/// The reason why the reports give no dwell, if there are reports.
pub(super) fn unused(reports: &[DwellReport], stream: &SampleStream) -> Option<MatchingFinding> {
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

/// Intervals between the reports of start and end, by index, s of the stream. `None` without an interval, or if the device
/// clock cannot be compared with the host's.
pub(super) fn spans(reports: &[DwellReport], stream: &SampleStream) -> Option<BTreeMap<u32, Range<f64>>> {
    let span = |(index, [start, end]): (u32, [&DwellReport; 2])| {
        Some((index, stream.time_of(start.host)?..stream.time_of(end.host)?))
    };
    let spans: BTreeMap<u32, Range<f64>> = pairs(reports).into_iter().map(span).collect::<Option<_>>()?;
    (!spans.is_empty()).then_some(spans)
}

/// The reported dwells, shortened by the delay of a report: the robot surely stood for this time.
pub(super) fn reported_dwells(
    reports: &[DwellReport],
    stream: &SampleStream,
) -> Option<BTreeMap<u32, Dwell>> {
    let dwell = |span: Range<f64>| Dwell::whole(span.start, span.end - LATE_S, LATE_S);
    Some(spans(reports, stream)?.into_iter().map(|(index, span)| (index, dwell(span))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::recording::stream::StreamBuilder;
    use dbbd_model::measurement::sample::Sample;

    fn report(host_ms: u64, index: u32, phase: u8, first_deg: f64) -> DwellReport {
        let axes_deg = [first_deg, 0.0, 0.0, 0.0, 0.0, 0.0];
        DwellReport { host: HostNs(host_ms * 1_000_000), index, phase, axes_deg }
    }

    fn stream() -> SampleStream {
        let mut builder = StreamBuilder::new(None);
        builder.push(HostNs(1_000_000_000), &Sample::of(1.0));
        builder.build()
    }

    #[test]
    fn axes_are_the_mean_of_start_and_end() {
        let axes = reported_axes(&[
            report(0, 3, 1, 10.0),
            report(1, 3, 2, 11.0),
            report(2, 4, 2, 7.0),
            report(3, 5, 1, 5.0),
            report(4, 6, 2, 9.0),
        ]);
        let first: Vec<(u32, f64)> = axes.iter().map(|(index, axes)| (*index, axes[0])).collect();
        assert_eq!(first, [(3, 10.5), (4, 7.0), (5, 5.0), (6, 9.0)]);
    }

    /// The second visit was broken off: length and axes are of the first one. A third one replaces it.
    #[test]
    fn a_pose_that_is_driven_twice_has_length_and_axes_of_one_visit() {
        let mut reports = vec![report(1500, 3, 1, 10.0), report(2500, 3, 2, 11.0), report(3000, 3, 1, 20.0)];
        let found = |reports: &[DwellReport]| {
            (reported_axes(reports)[&3][0], reported_dwells(reports, &stream()).unwrap()[&3].start_s)
        };
        assert_eq!(found(&reports), (10.5, 0.5));
        reports.extend([report(4000, 3, 1, 30.0), report(5000, 3, 2, 31.0)]);
        assert_eq!(found(&reports), (30.5, 3.0));
    }

    /// The stream begins at 1 s of the host; the report of the end may be 50 ms late.
    #[test]
    fn dwell_lasts_from_start_to_end() {
        let reports = [
            report(1500, 3, 1, 0.0),
            report(2500, 3, 2, 0.0),
            report(3000, 4, 1, 0.0),
            report(3500, 5, 2, 0.0),
        ];
        let dwells = reported_dwells(&reports, &stream()).unwrap();
        assert_eq!(dwells.keys().copied().collect::<Vec<_>>(), [3]);
        let dwell = dwells[&3];
        assert!((dwell.start_s - 0.5).abs() < 1e-12 && (dwell.end_s - 1.45).abs() < 1e-12);
        assert!((dwell.start_sd_s - 0.05).abs() < 1e-12);
    }

    #[test]
    fn reports_without_pairs_are_unused() {
        let unpaired = [report(1500, 3, 1, 0.0), report(2000, 4, 2, 0.0)];
        assert_eq!(unused(&unpaired, &stream()), Some(MatchingFinding::ReportsUnpaired { reports: 2 }));
        assert_eq!(unused(&[report(1500, 3, 1, 0.0), report(2000, 3, 2, 0.0)], &stream()), None);
        assert_eq!(unused(&[], &stream()), None);
    }
}
