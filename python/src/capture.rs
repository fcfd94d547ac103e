//! `Capture`: what a run recorded, and its lengths at the poses of its plan.

use std::collections::BTreeMap;
use std::iter;
use std::path::PathBuf;

use dbbd_job::recording::capture::{CaptureRecord, CaptureSummary, RunEvent};
use dbbd_job::recording::run;
use dbbd_job::request::identify::measured_conditions;
use dbbd_model::diagnostic::Diagnostic;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

use crate::arrays::array;
use crate::error::{Failure, to_python};
use crate::lengths::{BallPlaces, table};
use crate::plan::PyPlan;

/// The samples of a capture, a column each.
#[derive(Default)]
struct Samples {
    host_ns: Vec<u64>,
    reading_mm: Vec<f64>,
    sequence: Vec<i64>,
    ticks: Vec<i64>,
    trigger: Vec<i8>,
    valid: Vec<bool>,
    temperature_c: Vec<f64>,
    status: Vec<u32>,
    offset: Vec<u64>,
}

/// A recorded run.
#[pyclass(name = "Capture", module = "dbbd", frozen)]
pub(crate) struct PyCapture {
    path: PathBuf,
    samples: Samples,
    events: Vec<Value>,
    findings: Vec<Diagnostic>,
    attachments: BTreeMap<String, Vec<u8>>,
}

impl PyCapture {
    fn read(path: PathBuf) -> Result<Self, Failure> {
        let name = path.display().to_string();
        let (mut samples, mut events, mut attachments) = (Samples::default(), Vec::new(), BTreeMap::new());
        let pass = CaptureSummary::over(&path, |stamped| {
            match stamped.record {
                CaptureRecord::Samples(read) => {
                    for sample in read {
                        samples.host_ns.push(stamped.host.0);
                        samples.reading_mm.push(sample.reading_mm);
                        samples.sequence.push(sample.sequence.map_or(-1, i64::from));
                        samples.ticks.push(sample.ticks.map_or(-1, |ticks| ticks.0.cast_signed()));
                        samples.trigger.push(sample.trigger.map_or(-1, i8::from));
                        samples.valid.push(sample.valid);
                        samples.temperature_c.push(sample.temperature_c.unwrap_or(f64::NAN));
                        samples.status.push(sample.status);
                        samples.offset.push(sample.offset);
                    }
                }
                CaptureRecord::Event(event) => events.push(with_time(stamped.host.0, &event)),
                CaptureRecord::Attachment { name, content } => {
                    attachments.insert(name, content);
                }
                CaptureRecord::Raw(_) | CaptureRecord::Fault(_) | CaptureRecord::Axes(_) => {}
            }
            Ok(())
        })?;
        let findings =
            pass.all_findings().into_iter().map(|finding| Diagnostic::file(&name, finding)).collect();
        Ok(Self { path, samples, events, findings, attachments })
    }
}

fn with_time(host_ns: u64, event: &RunEvent) -> Value {
    let mut value = serde_json::to_value(event).unwrap_or_default();
    if let Some(object) = value.as_object_mut() {
        object.insert("host_ns".into(), host_ns.into());
    }
    value
}

#[pymethods]
impl PyCapture {
    /// Reads the capture at `path`, past every damage; what it lacks is in `findings`.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> Result<Self, Failure> {
        py.detach(|| Self::read(path))
    }

    /// The decoded samples, an array each: `host_ns`, `reading_mm`, `sequence`, `ticks` and `trigger` (-1: not sent),
    /// `valid`, `temperature_c` (NaN: not sent), `status`, `offset` (byte of the stream).
    fn samples<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        fn put<'py, T: numpy::Element + Clone>(
            columns: &Bound<'py, PyDict>,
            name: &str,
            values: &[T],
        ) -> PyResult<()> {
            let column: Bound<'py, PyArrayDyn<T>> = array(columns.py(), values.to_vec(), &[values.len()])?;
            columns.set_item(name, column)
        }
        let (columns, samples) = (PyDict::new(py), &self.samples);
        put(&columns, "host_ns", &samples.host_ns)?;
        put(&columns, "reading_mm", &samples.reading_mm)?;
        put(&columns, "sequence", &samples.sequence)?;
        put(&columns, "ticks", &samples.ticks)?;
        put(&columns, "trigger", &samples.trigger)?;
        put(&columns, "valid", &samples.valid)?;
        put(&columns, "temperature_c", &samples.temperature_c)?;
        put(&columns, "status", &samples.status)?;
        put(&columns, "offset", &samples.offset)?;
        Ok(columns)
    }

    /// What happened around the samples, a dictionary each with `event` and `host_ns`.
    fn events(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.events)
    }

    /// The plan that the capture carries, or None.
    #[getter]
    fn plan(&self) -> Result<Option<PyPlan>, Failure> {
        let plan = run::attached_plan(&self.path.display().to_string(), &self.attachments)?;
        plan.map(PyPlan::of).transpose()
    }

    /// What the capture lacks, a dictionary each with `code` and `text`.
    #[getter]
    fn findings(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        to_python(py, &self.findings)
    }

    /// The lengths at the poses of the plan, as `identify` and `check` take them: a dictionary with their arguments
    /// `axes_deg`, `lengths_mm`, `ball`, `sigma_mm`, `approach`, `index`, `balls_mm`, `payload`, `force_n`, `t_s`, `measured`
    /// and `temperature_c`, None where the run does not tell; the findings of the matching.
    fn lengths<'py>(&self, py: Python<'py>) -> Result<(Bound<'py, PyDict>, Py<PyAny>), Failure> {
        let (matching, balls, measured, found) = py.detach(|| {
            let mut found = Vec::new();
            let run = run::open_run(&self.path, None, &[], &mut |finding| found.push(finding))?;
            let matching = run.matching(None)?;
            found.extend(matching.findings.iter().cloned().map(Diagnostic::from));
            let identity = run.traced(&self.path)?.provenance.identity;
            let measured = measured_conditions(iter::once(&identity), &matching.observations);
            Ok::<_, Diagnostic>((matching, run.centres(), measured, found))
        })?;
        Ok((table(py, &matching.observations, &BallPlaces(&balls), &measured)?, to_python(py, &found)?))
    }

    fn __repr__(&self) -> String {
        format!("<dbbd.Capture {:?}: {} samples>", self.path, self.samples.host_ns.len())
    }
}
