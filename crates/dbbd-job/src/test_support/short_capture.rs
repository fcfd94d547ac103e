//! A capture with each kind of record.

use std::path::Path;

use dbbd_job::recording::capture::{CaptureRecord, CaptureWriter, RunEnd, RunEvent, StampedRecord};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::measurement::sample::Sample;

pub(crate) const PLAIN: Sample = Sample {
    reading_mm: -0.1,
    sequence: Some(0),
    ticks: None,
    trigger: Some(true),
    temperature_c: Some(20.5),
    valid: true,
    status: 0x8000_0010,
    offset: 1 << 40,
};

pub(crate) fn records() -> Vec<StampedRecord> {
    let records = vec![
        CaptureRecord::Event(RunEvent::Started { unix_ns: 1, version: "0".into() }),
        CaptureRecord::Attachment { name: "plan.csv".into(), content: b"index\n1\n".to_vec() },
        CaptureRecord::Raw(vec![0xdb, 0xbd, 0x5a, 0xa5, 2, 0, 0, 0, 0]),
        CaptureRecord::Samples(vec![
            PLAIN,
            Sample { sequence: Some(u32::MAX), ticks: Some(DeviceTicks(u64::MAX)), ..PLAIN },
        ]),
        CaptureRecord::Fault(b"{}".to_vec()),
        CaptureRecord::Raw((0..=255).collect()),
        CaptureRecord::Event(RunEvent::Gap { seconds: Some(0.25), missing: None, reason: "r".into() }),
        CaptureRecord::Event(RunEvent::Ended(RunEnd { reason: "done".into(), samples: 2, lost: 0 })),
    ];
    let stamped =
        records.into_iter().zip(1u64..).map(|(record, at)| StampedRecord { host: HostNs(at << 40), record });
    stamped.collect()
}

pub(crate) fn write(path: &Path) -> (Vec<u8>, Vec<usize>) {
    let mut writer = CaptureWriter::create(path).unwrap();
    let mut ends = vec![std::fs::metadata(path).unwrap().len() as usize];
    for stamped in records() {
        writer.write(stamped.host, &stamped.record).unwrap();
        ends.push(std::fs::metadata(path).unwrap().len() as usize);
    }
    (std::fs::read(path).unwrap(), ends)
}
