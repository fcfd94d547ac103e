//! NumPy arrays in and out.

use dbbd_model::robot::{AXES, Approach, Pose};
use numpy::{AllowTypeChange, PyArray, PyArrayDyn, PyArrayLikeDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Numbers of any shape: an array, or what NumPy makes one of.
pub(crate) type Numbers<'py> = PyArrayLikeDyn<'py, f64, AllowTypeChange>;
/// The same of whole numbers.
pub(crate) type Wholes<'py> = PyArrayLikeDyn<'py, i64, AllowTypeChange>;

/// What a call returns.
pub(crate) type Floats<'py> = Bound<'py, PyArrayDyn<f64>>;

/// Rows of an array of the shape (N, `W`) or (`W`,).
pub(crate) struct Rows<const W: usize> {
    pub(crate) rows: Vec<[f64; W]>,
    /// Whether it was one row without the outer dimension.
    pub(crate) single: bool,
}

impl<const W: usize> Rows<W> {
    pub(crate) fn of(array: &Numbers<'_>, name: &str) -> PyResult<Self> {
        let (flat, single) = match array.shape() {
            [width] if *width == W => (flat(array), true),
            [_, width] if *width == W => (flat(array), false),
            shape => return Err(shape_error(name, &format!("(N, {W}) or ({W},)"), shape)),
        };
        Ok(Self { rows: flat.as_chunks::<W>().0.to_vec(), single })
    }

    /// The shape of the result: this of one row, with the number of rows before it where there are many.
    pub(crate) fn shape(&self, of_row: &[usize]) -> Vec<usize> {
        let outer = (!self.single).then_some(self.rows.len());
        outer.into_iter().chain(of_row.iter().copied()).collect()
    }
}

/// The numbers in the order of their rows.
pub(crate) fn flat(array: &Numbers<'_>) -> Vec<f64> {
    match array.as_slice() {
        Ok(slice) => slice.to_vec(),
        Err(_) => array.as_array().iter().copied().collect(),
    }
}

/// One number a row: an array of `rows`, or one number for all.
pub(crate) fn column<T: Copy + numpy::Element>(
    array: &PyArrayLikeDyn<'_, T, AllowTypeChange>,
    name: &str,
    rows: usize,
) -> PyResult<Vec<T>> {
    match array.shape() {
        [] => Ok(vec![array.as_array().iter().copied().next().ok_or_else(|| empty(name))?; rows]),
        [length] if *length == rows => Ok(array.as_array().iter().copied().collect()),
        shape => Err(shape_error(name, &format!("({rows},) or a number"), shape)),
    }
}

fn empty(name: &str) -> PyErr {
    PyValueError::new_err(format!("{name} is empty"))
}

pub(crate) fn shape_error(name: &str, expected: &str, shape: &[usize]) -> PyErr {
    PyValueError::new_err(format!("{name} must have the shape {expected}, not {shape:?}"))
}

/// An array of this shape.
pub(crate) fn array<'py, T: numpy::Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    PyArray::from_vec(py, values).reshape(shape)
}

/// Homogeneous matrices (mm) of the shape (N, 4, 4) or (4, 4); whether it is one.
pub(crate) fn poses(array: &Numbers<'_>, name: &str) -> PyResult<(Vec<Pose>, bool)> {
    let single = match array.shape() {
        [4, 4] => true,
        [_, 4, 4] => false,
        shape => return Err(shape_error(name, "(N, 4, 4) or (4, 4)", shape)),
    };
    Ok((flat(array).as_chunks::<16>().0.iter().map(pose).collect(), single))
}

fn pose(m: &[f64; 16]) -> Pose {
    // Columns of the rotation.
    let rotation = [[m[0], m[4], m[8]], [m[1], m[5], m[9]], [m[2], m[6], m[10]]];
    Pose { rotation: rotation.into(), position: [m[3], m[7], m[11]].into() }
}

/// A pose as a homogeneous matrix (mm), row by row.
pub(crate) fn matrix(pose: &Pose) -> [f64; 16] {
    let (r, p) = (&pose.rotation, &pose.position);
    [
        r[(0, 0)],
        r[(0, 1)],
        r[(0, 2)],
        p.x,
        r[(1, 0)],
        r[(1, 1)],
        r[(1, 2)],
        p.y,
        r[(2, 0)],
        r[(2, 1)],
        r[(2, 2)],
        p.z,
        0.0,
        0.0,
        0.0,
        1.0,
    ]
}

/// The senses of approach of `rows` poses, of the shape (N, 6); not known where there is no array.
pub(crate) fn approaches(array: Option<&Wholes<'_>>, rows: usize) -> PyResult<Vec<Approach>> {
    let Some(array) = array else { return Ok(vec![Approach::default(); rows]) };
    if array.shape() != [rows, AXES] {
        return Err(shape_error("approach", &format!("({rows}, {AXES})"), array.shape()));
    }
    let senses: Vec<i8> = array.as_array().iter().map(|sense| sense.signum() as i8).collect();
    Ok(senses.as_chunks::<AXES>().0.iter().map(|senses| Approach::new(*senses)).collect())
}
