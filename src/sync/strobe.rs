//! The controller's strobe in the stream: dwells, and the pulses that mark begin and end of a module.

use std::ops::Range;

use super::seen::Stretch;
use super::stream::Stream;

/// A dwell that the strobe showed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strobed {
    /// From the strobe's rise to its fall.
    pub stretch: Stretch,
    /// Number of the module as the marks tell, from 0.
    pub module: usize,
}

/// A strobe shorter than this is a pulse of a mark, s.
const PULSE_S: f64 = 0.3;
/// Pulses of one mark are nearer to each other, s.
const ONE_MARK_S: f64 = 1.0;
/// A strobe that falls for less than this did not fall: no program lowers it so shortly, s.
const BOUNCE_S: f64 = 0.1;

/// Whether the stream carries the strobe and it was ever high.
pub(super) fn present(stream: &Stream) -> bool {
    (0..stream.len()).any(|at| stream.trigger(at) == Some(true))
}

/// The dwells by the strobe, split at the marks: three pulses begin a module, two end it.
pub fn find(stream: &Stream) -> Vec<Strobed> {
    let mut dwells: Vec<Strobed> = Vec::new();
    let mut module = 0;
    let mut pulses = 0;
    let mut last_pulse_s = f64::NEG_INFINITY;
    // A mark of which a pulse was lost still divides: either kind stands between two modules.
    let mut close_mark = |pulses: &mut u32, dwells: &[Strobed]| {
        if *pulses > 0 && dwells.last().is_some_and(|dwell| dwell.module == module) {
            module += 1;
        }
        *pulses = 0;
        module
    };
    for high in highs(stream) {
        if high.end_s - high.start_s < PULSE_S {
            if high.start_s - last_pulse_s > ONE_MARK_S {
                close_mark(&mut pulses, &dwells);
            }
            pulses += 1;
            last_pulse_s = high.start_s;
        } else {
            let module = close_mark(&mut pulses, &dwells);
            dwells.push(Strobed { stretch: high, module });
        }
    }
    dwells
}

/// For each module the positions of its dwells in `commanded` and in `told`, which hold the modules' numbers in
/// order.
pub(super) fn counts(commanded: &[usize], told: &[usize]) -> Vec<(Range<usize>, Range<usize>)> {
    let of = |all: &[usize], module: usize| {
        all.partition_point(|other| *other < module)..all.partition_point(|other| *other <= module)
    };
    let modules = [commanded, told].into_iter().filter_map(|all| all.last()).max().map_or(0, |last| last + 1);
    (0..modules).map(|module| (of(commanded, module), of(told, module))).collect()
}

/// The times for which the strobe was high.
fn highs(stream: &Stream) -> Vec<Stretch> {
    let mut highs = Vec::new();
    let mut rise_s = None;
    for (at, &t_s) in stream.t_s.iter().enumerate() {
        match (stream.trigger(at), rise_s) {
            (Some(true), None) => {
                let before = highs.pop_if(|before: &mut Stretch| t_s - before.end_s < BOUNCE_S);
                rise_s = Some(before.map_or(t_s, |before| before.start_s));
            }
            (Some(false), Some(start_s)) => {
                // The last sample that was high ends it: the strobe may have fallen in a gap.
                let end_s = stream.t_s[at - 1];
                highs.push(Stretch { start_s, end_s, start_sd_s: 0.0 });
                rise_s = None;
            }
            _ => {}
        }
    }
    if let (Some(start_s), Some(&end_s)) = (rise_s, stream.t_s.last()) {
        highs.push(Stretch { start_s, end_s, start_sd_s: 0.0 });
    }
    highs
}
