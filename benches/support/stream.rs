//! What a bar sends.
#![allow(clippy::unwrap_used)]

use dbbd_device::protocol::ProtocolDefinition;
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;

pub(crate) fn stream(definition: &ProtocolDefinition, frames: u32) -> Vec<u8> {
    let (encoder, mut bytes) = (definition.encoder(), Vec::new());
    for frame in 0..frames {
        let sample = Sample {
            sequence: Some(frame % definition.sequence_modulo.unwrap_or(65536)),
            ticks: Some(DeviceTicks(u64::from(frame) * 1000)),
            trigger: Some(false),
            temperature_c: Some(20.0),
            status: 1,
            ..Sample::of(definition.sim.at_mm + f64::from(frame % 2000) / 1000.0 - 1.0)
        };
        encoder.encode(&sample, &mut bytes).unwrap();
    }
    bytes
}
