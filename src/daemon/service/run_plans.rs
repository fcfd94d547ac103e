//! Finds the plan to which a run belongs.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use dbbd_device::sync::lock;
use dbbd_job::recording::capture::{CapturePart, CaptureReader, CaptureRecord};
use serde_json::Value;

use super::runs::open_plain;

/// Bytes at the begin of a capture that hold the files in force: a plan of 1000 poses has a few hundred kB.
const CAPTURE_HEAD: u64 = 16 << 20;

/// The plan of a run.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RunPlan {
    pub hash: String,
    /// Whether the plan is for the check of a calibrated robot.
    pub is_check: bool,
}

/// A capture by its path and its start, ms since the Unix epoch.
type CaptureKey = (PathBuf, Option<u64>);

/// The plans of captures: the begin of a capture never changes.
#[derive(Default)]
pub(super) struct RunPlans(Mutex<BTreeMap<CaptureKey, Option<RunPlan>>>);

impl RunPlans {
    pub(super) fn of(&self, path: &Path, started_ms: Option<u64>) -> Option<RunPlan> {
        let key = (path.to_owned(), started_ms);
        if let Some(known) = lock(&self.0).get(&key) {
            return known.clone();
        }
        let plan = attached_plan(path)?;
        lock(&self.0).insert(key, plan.clone());
        plan
    }
}

/// The plan in a capture, which precedes all samples; `None` while nothing is recorded yet.
fn attached_plan(path: &Path) -> Option<Option<RunPlan>> {
    let reader = CaptureReader::new(open_plain(path).ok()?.take(CAPTURE_HEAD)).ok()?;
    for part in reader.flatten() {
        let CapturePart::Record(stamped) = part else { continue };
        match stamped.record {
            CaptureRecord::Attachment { name, content } if name == "plan.json" => {
                let header: Value = serde_json::from_slice(&content).ok()?;
                let (hash, is_check) = (header["hash"].as_str()?.to_owned(), header["check"].is_object());
                return Some(Some(RunPlan { hash, is_check }));
            }
            CaptureRecord::Raw(_) | CaptureRecord::Samples(_) => return Some(None),
            CaptureRecord::Attachment { .. }
            | CaptureRecord::Fault(_)
            | CaptureRecord::Axes(_)
            | CaptureRecord::Event(_) => {}
        }
    }
    None
}
