//! The map from a device's counter to the host's clock on a simulated adapter: 50 ppm of drift, 16 ms batches,
//! stalls. The
//! figures are those of the method's simulation in the reference: least delay 0.5 ms, exponential jitter of 0.3 ms,
//! stalls of 50 ms in 0.1 % of the samples.

use dbbd_job::recording::{ClockMap, ClockStamp, DeviceClock};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const LEAST_S: f64 = 0.5e-3;
const DRIFT: f64 = 50e-6;
const CLOCK: DeviceClock = DeviceClock { seconds_per_tick: 1e-6, wrap: Some(1 << 32) };

struct Run {
    stamps: Vec<ClockStamp>,
    /// True host time of each sample, s.
    truth: Vec<f64>,
}

fn run(seconds: f64, hz: f64, seed: u64) -> Run {
    let mut dice = Pcg64::seed_from_u64(seed);
    let mut exponential = |mean: f64| -mean * (1.0 - dice.random::<f64>()).ln();
    let (mut stamps, mut truth, mut last) = (Vec::new(), Vec::new(), 0.0f64);
    let mut count = 0u64;
    for at in 0..(seconds * hz) as u64 {
        let device = at as f64 / hz;
        let t = 1.0 + device / (1.0 + DRIFT);
        let ticks = (device * 1e6).round() as u64 + (1 << 32) - 300_000_000;
        let mut ready = t + LEAST_S + exponential(0.3e-3);
        count += 1;
        if count.is_multiple_of(997) {
            ready += exponential(50e-3);
        }
        // The adapter delivers its bytes every 16 ms of the host's time, in order.
        let handed = ((ready - 1e-3) / 0.016).ceil() * 0.016 + 1e-3;
        let handed = if handed - ready > 0.0159 { ready } else { handed };
        last = last.max(handed);
        stamps.push(ClockStamp { host: HostNs((last * 1e9) as u64), ticks: DeviceTicks(ticks % (1 << 32)) });
        truth.push(t);
    }
    Run { stamps, truth }
}

/// The map, and the device times of the stamps, s.
fn map_of(stamps: &[ClockStamp]) -> (ClockMap, Vec<f64>) {
    let map = ClockMap::new(&stamps.iter().copied().collect(), CLOCK);
    let device_s = stamps.iter().copied().map(map.device_time(CLOCK)).collect();
    (map, device_s)
}

/// Mean and standard deviation, ms.
fn spread(errors: &[f64]) -> (f64, f64) {
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let variance = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / errors.len() as f64;
    (1e3 * mean, 1e3 * variance.sqrt())
}

#[test]
fn hull_is_biased_by_the_least_delay_only() {
    for seed in 0..10 {
        let Run { stamps, truth } = run(600.0, 100.0, seed);
        let (map, device_s) = map_of(&stamps);
        assert_eq!(map.breaks, []);
        let begin = map.begin.0 as f64 * 1e-9;
        let hull: Vec<f64> =
            device_s.iter().zip(&truth).map(|(t, truth)| begin + map.host_s(*t).unwrap() - truth).collect();
        let arrival: Vec<f64> =
            stamps.iter().zip(&truth).map(|(stamp, t)| stamp.host.0 as f64 * 1e-9 - t).collect();
        // A least-squares line through the same points.
        let n = truth.len() as f64;
        let host: Vec<f64> = stamps.iter().map(|stamp| stamp.host.0 as f64 * 1e-9).collect();
        let (mt, mh) = (device_s.iter().sum::<f64>() / n, host.iter().sum::<f64>() / n);
        let slope = device_s.iter().zip(&host).map(|(t, h)| (t - mt) * (h - mh)).sum::<f64>()
            / device_s.iter().map(|t| (t - mt).powi(2)).sum::<f64>();
        let line: Vec<f64> =
            device_s.iter().zip(&truth).map(|(t, truth)| mh + (t - mt) * slope - truth).collect();
        let [hull, arrival, line] = [&hull, &arrival, &line].map(|errors| spread(errors));
        eprintln!(
            "seed {seed}: arrival {arrival:.4?}, least squares {line:.4?}, hull {hull:.4?} ms (mean, sd)"
        );
        assert!((hull.0 - 1e3 * LEAST_S).abs() < 0.1, "bias {hull:?}");
        assert!(hull.1 < 0.020, "sigma {hull:?}");
        assert!(arrival.0 > 5.0 && line.0 > 5.0);
        for segment in &map.segments {
            assert!((segment.drift + DRIFT).abs() < 5e-6, "{segment:?}");
        }
    }
}

#[test]
fn resets_and_jumps_are_breaks_and_wraps_are_not() {
    let Run { mut stamps, .. } = run(120.0, 100.0, 3);
    let reset = stamps.len() / 2;
    let from = stamps[reset].ticks.0;
    for stamp in &mut stamps[reset..] {
        stamp.ticks = DeviceTicks(stamp.ticks.0.wrapping_sub(from) % (1 << 32));
    }
    let (map, device_s) = map_of(&stamps);
    assert_eq!(map.breaks.iter().map(|broken| broken.at).collect::<Vec<_>>(), [reset]);
    assert!(device_s.windows(2).all(|pair| pair[1] >= pair[0]));
    assert!(map.breaks[0].reset);
    assert_eq!(map_of(&[]).0.host_s(0.0), None);
    assert!(map_of(&stamps[..2000]).0.host_s(0.0).is_some());
}

/// A jump is distinguished from a stall: only the jump shifts the least delay permanently.
#[test]
fn jump_is_a_break_and_stall_is_not() {
    for (jump_s, stall_s, expected) in
        [(0.4, 0.0, 1), (-0.4, 0.0, 1), (0.0, 3.0, 0), (0.0, 0.0, 0), (2.0, 1.0, 1)]
    {
        let Run { mut stamps, .. } = run(60.0, 100.0, 5);
        let (jump, stall) = (4000, 2000);
        for stamp in &mut stamps[jump..] {
            stamp.ticks = DeviceTicks((stamp.ticks.0 as i64 + (jump_s * 1e6) as i64) as u64 % (1 << 32));
        }
        let held = HostNs(stamps[stall].host.0 + (stall_s * 1e9) as u64);
        for stamp in &mut stamps[stall..] {
            stamp.host = stamp.host.max(held);
        }
        let (map, _) = map_of(&stamps);
        let found: Vec<usize> = map.breaks.iter().map(|broken| broken.at).collect();
        assert_eq!(found, vec![jump; expected], "jump {jump_s} s, stall {stall_s} s");
        assert!(map.breaks.iter().all(|broken| broken.reset == (jump_s < 0.0)), "{:?}", map.breaks);
        assert!(map.drift().is_some_and(|drift| (drift + DRIFT).abs() < 20e-6), "{:?}", map.drift());
    }
}

/// A counter faster than the host's clock is not mapped to it; its own breaks are still detected.
#[test]
fn run_faster_than_real_time_uses_device_time_only() {
    let stamp = |at: u64| ClockStamp { host: HostNs(at * 1000), ticks: DeviceTicks(at * 1000) };
    let mut stamps: Vec<ClockStamp> = (0..10_000).map(stamp).collect();
    // The host may be delayed in such a run.
    stamps.iter_mut().skip(7000).for_each(|stamp| stamp.host.0 += 700_000_000);
    let (map, device_s) = map_of(&stamps);
    assert_eq!((map.breaks.len(), map.host_s(1.0), map.drift()), (0, None, None));
    assert!((device_s[9999] - 9.999).abs() < 1e-9);
    stamps.iter_mut().skip(5000).for_each(|stamp| stamp.ticks.0 += 10_000_000);
    assert_eq!(map_of(&stamps).0.breaks.len(), 1);
}
