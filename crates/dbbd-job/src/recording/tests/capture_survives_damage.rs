//! A capture is read past each damage, and each damage is reported.

use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

use dbbd_job::recording::RecordingFinding::{TornHead, TornRecord};
use dbbd_job::recording::capture::{self, CaptureRecord, CaptureWriter, Disk};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::diagnostic::Finding;
use dbbd_model::measurement::sample::Sample;
use proptest::prelude::*;

use crate::test_support::short_capture::{records, write};

fn written() -> (Vec<u8>, Vec<usize>) {
    write(&tempfile::tempdir().unwrap().path().join("run"))
}

#[test]
fn written_records_are_read_back() {
    let (bytes, _) = written();
    let capture = capture::read_capture(&bytes);
    assert_eq!(capture.records, records());
    assert_eq!(capture.damages, []);
    assert!(capture.ended());
    assert_eq!(capture.attachment("plan.csv"), Some(&b"index\n1\n"[..]));
}

#[test]
fn capture_is_never_overwritten() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let (bytes, _) = write(&path);
    assert_eq!(CaptureWriter::create(&path).err().unwrap().code().as_str(), "E0401");
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
}

#[test]
fn truncation_at_any_byte_keeps_a_prefix() {
    let (bytes, ends) = written();
    for cut in 0..=bytes.len() {
        let capture = capture::read_capture(&bytes[..cut]);
        let whole = ends.iter().filter(|end| **end <= cut).count().saturating_sub(1);
        assert_eq!(capture.records, records()[..whole], "cut at {cut}");
        if cut == 0 || ends.contains(&cut) {
            assert_eq!(capture.damages, [], "cut at {cut}");
        } else {
            let [damage] = &capture.damages[..] else { panic!("cut at {cut}: {:?}", capture.damages) };
            assert_eq!((damage.offset + damage.bytes) as usize, cut);
            let torn = matches!(damage.finding, TornHead { .. } | TornRecord { .. });
            assert!(cut < ends[0] || torn, "cut at {cut}: {:?}", damage.finding);
            assert_eq!(damage.finding.code().as_str(), "W0410");
        }
    }
}

#[test]
fn each_flipped_bit_loses_one_record() {
    let (bytes, ends) = written();
    for bit in 0..8 * bytes.len() {
        let mut bytes = bytes.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let capture = capture::read_capture(&bytes);
        let harmed = ends.iter().filter(|end| **end <= bit / 8).count();
        let mut expected = records();
        if harmed > 0 {
            expected.remove(harmed - 1);
        }
        assert_eq!(capture.records, expected, "bit {bit}");
        let [damage] = &capture.damages[..] else { panic!("bit {bit}: {:?}", capture.damages) };
        let start = if harmed == 0 { 0 } else { ends[harmed - 1] };
        assert_eq!(
            (damage.offset as usize, damage.bytes as usize),
            (start, ends[harmed] - start),
            "bit {bit}"
        );
    }
}

/// A disk that takes a number of bytes in a number of writes, and then fails.
struct Failing {
    taken: Arc<Mutex<Vec<u8>>>,
    room: usize,
    cuts: bool,
}

impl Write for Failing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = bytes.len().min(self.room);
        self.room -= count;
        self.taken.lock().unwrap().extend(&bytes[..count]);
        if count == 0 { Err(ErrorKind::StorageFull.into()) } else { Ok(count) }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Disk for Failing {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn cut(&mut self, bytes: u64) -> io::Result<()> {
        if !self.cuts {
            return Err(ErrorKind::Other.into());
        }
        self.taken.lock().unwrap().truncate(bytes as usize);
        Ok(())
    }
}

#[test]
fn failing_disk_keeps_every_whole_record() {
    let (bytes, ends) = written();
    for room in 0..bytes.len() {
        for cuts in [true, false] {
            let taken = Arc::default();
            let disk = Failing { taken: Arc::clone(&taken), room, cuts };
            let failed = match CaptureWriter::on(Box::new(disk), Path::new("run")) {
                Ok(mut writer) => {
                    let mut written = records().into_iter().map(|s| writer.write(s.host, &s.record));
                    written.find_map(Result::err).unwrap()
                }
                Err(error) => error,
            };
            assert_eq!(failed.code().as_str(), "E0403");
            let whole = ends.iter().rposition(|end| *end <= room);
            let capture = capture::read_capture(&taken.lock().unwrap());
            assert_eq!(capture.records, records()[..whole.unwrap_or(0)], "room for {room}");
            let torn = !cuts && !ends.contains(&room) && room > 0;
            assert_eq!(capture.damages.len(), usize::from(torn), "room for {room}");
        }
    }
}

/// Reading from a file gives the same as from memory, however the bytes are split.
#[test]
fn single_byte_reads_give_the_same_records() {
    struct Drips<'a>(&'a [u8]);
    impl io::Read for Drips<'_> {
        fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
            let count = self.0.len().min(to.len()).min(1);
            to[..count].copy_from_slice(&self.0[..count]);
            self.0 = &self.0[count..];
            Ok(count)
        }
    }
    let (mut bytes, _) = written();
    bytes[40] ^= 1;
    let parts = |source: &mut dyn io::Read| -> Vec<capture::CapturePart> {
        capture::CaptureReader::new(source).unwrap().map(Result::unwrap).collect()
    };
    assert_eq!(parts(&mut Drips(&bytes)), parts(&mut &bytes[..]));
}

fn sample() -> impl Strategy<Value = Sample> {
    let numbers = (any::<u64>(), any::<Option<u32>>(), any::<Option<u64>>(), any::<Option<bool>>());
    (numbers, any::<Option<u64>>(), any::<bool>(), 0u32..3, any::<u64>()).prop_map(
        |((bits, sequence, ticks, trigger), temperature, valid, status, offset)| Sample {
            // Any bits but those of a NaN, which equals nothing.
            reading_mm: Some(f64::from_bits(bits)).filter(|mm| !mm.is_nan()).unwrap_or(0.5),
            sequence,
            ticks: ticks.map(DeviceTicks),
            trigger,
            temperature_c: temperature.map(f64::from_bits).filter(|c| !c.is_nan()),
            valid,
            status,
            offset,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn samples_come_back_bit_for_bit(samples in prop::collection::vec(sample(), 1..40)) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("run");
        let record = CaptureRecord::Samples(samples);
        CaptureWriter::create(&path).unwrap().write(HostNs(1), &record).unwrap();
        let capture = capture::read_capture(&std::fs::read(&path).unwrap());
        prop_assert_eq!(capture.damages, []);
        prop_assert_eq!(&capture.records[0].record, &record);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_read(head in prop::collection::vec(any::<u8>(), 0..200), from in 0usize..400, to in 0usize..400) {
        let (bytes, _) = written();
        let (from, to) = (from.min(bytes.len()), to.min(bytes.len()));
        let spliced = [&bytes[..from], &head[..], &bytes[to..]].concat();
        let capture = capture::read_capture(&spliced);
        let damaged: u64 = capture.damages.iter().map(|damage| damage.bytes).sum();
        prop_assert!(damaged <= spliced.len() as u64);
        capture::read_capture(&head);
    }
}
