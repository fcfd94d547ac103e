//! Decoding speed of every definition, beside a bare COBS and CRC loop over the same bytes.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "support/stream.rs"]
mod stream;

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use dbbd_device::protocol::ProtocolDefinition;

use stream::stream;

const FRAMES: u32 = 10_000;

/// The least that has to be done: find the zeros, undo the stuffing, take the CRC by table.
fn bare(bytes: &[u8], crc: &crc::Crc<u16, crc::Table<1>>) -> u64 {
    let mut good = 0;
    let mut body = [0u8; 64];
    for frame in bytes.split(|byte| *byte == 0) {
        let (mut length, mut at) = (0, 0);
        while at < frame.len() {
            let code = usize::from(frame[at]);
            let end = (at + code).min(frame.len());
            let block = &frame[at + 1..end];
            body[length..length + block.len()].copy_from_slice(block);
            length += block.len();
            at = end;
            if at < frame.len() {
                body[length] = 0;
                length += 1;
            }
        }
        if length == 16 {
            good += u64::from(crc.checksum(&body[..14]).to_le_bytes() == body[14..16]);
        }
    }
    good
}

fn decoding(c: &mut Criterion) {
    let mut group = c.benchmark_group("decode");
    let cobs = stream(&ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap(), FRAMES);
    let crc = crc::Crc::<u16, crc::Table<1>>::new(&crc::CRC_16_IBM_3740);
    assert_eq!(bare(&cobs, &crc), u64::from(FRAMES));
    group.throughput(Throughput::Bytes(cobs.len() as u64));
    group.bench_function("bare COBS and CRC", |b| b.iter(|| bare(black_box(&cobs), &crc)));
    for (name, _) in ProtocolDefinition::built_in() {
        let definition = ProtocolDefinition::by_name(name).unwrap().unwrap();
        let bytes = stream(&definition, FRAMES);
        group.throughput(Throughput::Bytes(bytes.len() as u64));
        let mut out = Vec::new();
        group.bench_function(*name, |b| {
            b.iter(|| {
                out.clear();
                definition.decoder().push(black_box(&bytes), &mut out);
                out.len()
            });
        });
    }
    group.finish();
}

criterion_group!(benches, decoding);
criterion_main!(benches);
