//! Interpolation tables, such as aerodynamic coefficients over angle of attack
//! and Mach number, as smooth functions for the symbolic layer.
//!
//! A table is a natural cubic spline (second derivative zero at both ends),
//! continued by straight lines outside its grid; in two dimensions the tensor
//! product of two of them. Its value and its first and second derivatives are
//! continuous everywhere, across the edges too, as Newton's method needs
//! (de Boor, A Practical Guide to Splines, 1978).

use std::fmt;
use std::hash::{Hash, Hasher};

/// The reason why a table cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TableError {
    /// An axis has fewer than 2 points.
    #[error(
        "table `{table}`: the {axis} axis has {count} point(s); give at least 2, or use a constant or a table of fewer axes"
    )]
    TooFewPoints {
        /// Name of the table.
        table: String,
        /// Name of the axis, `x` or `y`.
        axis: &'static str,
        /// Number of points given.
        count: usize,
    },
    /// An axis does not increase strictly.
    #[error(
        "table `{table}`: the {axis} axis must increase strictly, but {axis}[{index}] = {value} follows {before}; sort the axis together with its values and drop repeated points"
    )]
    NotIncreasing {
        /// Name of the table.
        table: String,
        /// Name of the axis, `x` or `y`.
        axis: &'static str,
        /// Index, from 0, of the first point that is not above the one before.
        index: usize,
        /// The point before.
        before: f64,
        /// The point.
        value: f64,
    },
    /// The number of values is not the number of grid points.
    #[error(
        "table `{table}`: the grid has {expected} points but there are {found} values; give one value a grid point, with the last axis running fastest"
    )]
    WrongLength {
        /// Name of the table.
        table: String,
        /// Number of grid points.
        expected: usize,
        /// Number of values given.
        found: usize,
    },
    /// An axis or the values hold NaN or an infinity.
    #[error(
        "table `{table}`: {what}[{index}] is {value}; every entry must be a finite number, so fill in or drop that point"
    )]
    NonFinite {
        /// Name of the table.
        table: String,
        /// The place of the error: `x`, `y` or `values`.
        what: &'static str,
        /// Index, from 0.
        index: usize,
        /// The entry.
        value: f64,
    },
    /// Neither one nor two axes.
    #[error("table `{table}`: it has {found} axes; give 1 or 2")]
    WrongDimension {
        /// Name of the table.
        table: String,
        /// Number of axes given.
        found: usize,
    },
    /// The spline through the entries is beyond the range of floating point.
    #[error(
        "table `{table}`: its slopes overflow; scale the axes and the values to ordinary magnitudes and look for points that lie too close together"
    )]
    Overflow {
        /// Name of the table.
        table: String,
    },
}

/// An immutable 1-D or 2-D interpolation table, twice continuously
/// differentiable everywhere and linear outside its grid.
///
/// Tables are equal, and hash alike, where their names, axes and values agree
/// to the bit. Only these are serialised.
///
/// ```
/// use phugoid::Table;
///
/// let lift = Table::new_1d("CL", &[-0.1, 0.0, 0.1, 0.2], &[-0.4, 0.1, 0.6, 0.9])?;
/// assert_eq!(lift.eval1(0, 0.1), 0.6);
/// // Beyond the grid: a line, with the slope at the edge.
/// assert_eq!(lift.eval1(1, 0.2), lift.eval1(1, 7.0));
/// # Ok::<(), phugoid::TableError>(())
/// ```
#[derive(Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "Content", into = "Content"))]
pub struct Table {
    name: String,
    axes: Vec<Vec<f64>>,
    values: Vec<f64>,
    grid: Vec<Grid>,
    /// Polynomial coefficients: 4 a cell in 1-D, `[power of x]`, and 16 in
    /// 2-D, `[power of x][power of y]`, about the lower corner of the cell;
    /// cells row-major.
    cells: Vec<[f64; 4]>,
}

/// The saved form of a table.
#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
struct Content {
    name: String,
    axes: Vec<Vec<f64>>,
    values: Vec<f64>,
}

#[cfg(feature = "serde")]
impl From<Table> for Content {
    fn from(table: Table) -> Content {
        Content { name: table.name, axes: table.axes, values: table.values }
    }
}

#[cfg(feature = "serde")]
impl TryFrom<Content> for Table {
    type Error = TableError;

    fn try_from(content: Content) -> Result<Table, TableError> {
        Table::build(content.name, content.axes, content.values)
    }
}

impl Table {
    /// A table of one variable: `values[i]` at `x[i]`.
    ///
    /// # Errors
    /// If `x` has fewer than 2 points or does not increase strictly, if the
    /// number of values is not that of points, or an entry is not finite.
    pub fn new_1d(name: &str, x: &[f64], values: &[f64]) -> Result<Table, TableError> {
        Table::build(name.to_string(), vec![x.to_vec()], values.to_vec())
    }

    /// A table of two variables: `values[i * y.len() + j]` at `(x[i], y[j])`.
    ///
    /// # Errors
    /// As [`Table::new_1d`], for either axis.
    pub fn new_2d(name: &str, x: &[f64], y: &[f64], values: &[f64]) -> Result<Table, TableError> {
        let axes = vec![x.to_vec(), y.to_vec()];
        Table::build(name.to_string(), axes, values.to_vec())
    }

    fn build(name: String, axes: Vec<Vec<f64>>, values: Vec<f64>) -> Result<Table, TableError> {
        check(&name, &axes, &values)?;
        let grid: Vec<Grid> = axes.iter().map(|axis| Grid::new(axis)).collect();
        let cells = match axes.as_slice() {
            [x] => cells_1d(x, &values),
            [x, y] => cells_2d(x, y, &values),
            _ => unreachable!("the number of axes has been checked"),
        };
        let finite = |cell: &[f64; 4]| cell.iter().all(|c| c.is_finite());
        let wide = |axis: &Vec<f64>| !(axis[axis.len() - 1] - axis[0]).is_finite();
        if axes.iter().any(wide) || !cells.iter().all(finite) {
            return Err(TableError::Overflow { table: name });
        }
        Ok(Table { name, axes, values, grid, cells })
    }

    /// The name given to the table.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of variables, 1 or 2.
    pub fn dimension(&self) -> usize {
        self.axes.len()
    }

    /// The grid points along every axis.
    pub fn axes(&self) -> &[Vec<f64>] {
        &self.axes
    }

    /// The values at the grid points, the last axis running fastest.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The `dx`-th derivative at `x`; the value itself for `dx = 0`.
    ///
    /// The third derivative is piecewise constant and taken from the right at
    /// the grid points; all above are zero. If `x` is not finite, NaN.
    ///
    /// # Panics
    /// If the table has 2 dimensions.
    pub fn eval1(&self, dx: u8, x: f64) -> f64 {
        let mut out = [0.0];
        self.eval1_lanes(dx, &mut out, &[x]);
        out[0]
    }

    /// The partial derivative of order `dx` in `x` and `dy` in `y` at `(x, y)`.
    ///
    /// Third derivatives are taken from the right at the grid lines, those
    /// above are zero. If `x` or `y` is not finite, NaN.
    ///
    /// # Panics
    /// If the table has 1 dimension.
    pub fn eval2(&self, dx: u8, dy: u8, x: f64, y: f64) -> f64 {
        let mut out = [0.0];
        self.eval2_lanes(dx, dy, &mut out, &[x], &[y]);
        out[0]
    }

    /// [`Table::eval1`] at every `x`, into `out`.
    ///
    /// # Panics
    /// If the table has 2 dimensions, or the lengths differ.
    pub fn eval1_lanes(&self, dx: u8, out: &mut [f64], x: &[f64]) {
        let [grid] = self.grid.as_slice() else {
            panic!("table `{}` has 2 variables, not 1", self.name);
        };
        assert_eq!(out.len(), x.len(), "as many results as arguments");
        let axis = &self.axes[0];
        let mut cell = 0;
        for (out, &x) in out.iter_mut().zip(x) {
            cell = grid.find(axis, x, cell);
            *out = polynomial(dx, self.cells[cell], x - anchor(axis, cell));
        }
    }

    /// [`Table::eval2`] at every `(x, y)`, into `out`.
    ///
    /// # Panics
    /// If the table has 1 dimension, or the lengths differ.
    pub fn eval2_lanes(&self, dx: u8, dy: u8, out: &mut [f64], x: &[f64], y: &[f64]) {
        let [grid_x, grid_y] = self.grid.as_slice() else {
            panic!("table `{}` has 1 variable, not 2", self.name);
        };
        assert_eq!(out.len(), x.len(), "as many results as arguments");
        assert_eq!(out.len(), y.len(), "as many results as arguments");
        let (axis_x, axis_y) = (&self.axes[0], &self.axes[1]);
        let columns = axis_y.len() + 1;
        let (mut i, mut j) = (0, 0);
        for ((out, &x), &y) in out.iter_mut().zip(x).zip(y) {
            i = grid_x.find(axis_x, x, i);
            j = grid_y.find(axis_y, y, j);
            let cell = &self.cells[4 * (i * columns + j)..][..4];
            let v = y - anchor(axis_y, j);
            let in_x = [0, 1, 2, 3].map(|power| polynomial(dy, cell[power], v));
            *out = polynomial(dx, in_x, x - anchor(axis_x, i));
        }
    }
}

/// The `order`-th derivative of the cubic with coefficients `c`, at `u`.
///
/// The terms `0 * u` carry NaN through where nothing depends on `u`.
#[inline]
fn polynomial(order: u8, c: [f64; 4], u: f64) -> f64 {
    match order {
        0 => c[0] + u * (c[1] + u * (c[2] + u * c[3])),
        1 => c[1] + u * (2.0 * c[2] + u * (3.0 * c[3])),
        2 => 2.0 * c[2] + u * (6.0 * c[3]),
        3 => 6.0 * c[3] + 0.0 * u,
        _ => 0.0 * u + 0.0 * c[0],
    }
}

/// The search for the cell of a point along one axis.
///
/// An axis of `n` points has `n + 1` cells: cell 0 below the first point, cell
/// `i` from point `i - 1` to just below point `i`, cell `n` from the last point on.
#[derive(Clone)]
struct Grid {
    /// Cells per unit length, where the axis is (nearly) uniform.
    inverse_step: Option<f64>,
}

impl Grid {
    fn new(axis: &[f64]) -> Grid {
        let last = axis.len() - 1;
        let step = (axis[last] - axis[0]) / last as f64;
        let uniform =
            (axis.iter().enumerate()).all(|(i, x)| (x - (axis[0] + step * i as f64)).abs() <= 1e-6 * step);
        Grid { inverse_step: uniform.then_some(1.0 / step) }
    }

    /// The cell that `x` lies in; `guess` is looked at first, since mesh
    /// points that follow each other mostly share a cell. Any cell for NaN.
    #[inline]
    fn find(&self, axis: &[f64], x: f64, guess: usize) -> usize {
        let above = |cell: usize| cell == 0 || axis[cell - 1] <= x;
        let below = |cell: usize| cell == axis.len() || x < axis[cell];
        if above(guess) && below(guess) {
            return guess;
        }
        match self.inverse_step {
            Some(inverse_step) => {
                // The cast saturates, and takes NaN to 0.
                let cell = ((x - axis[0]) * inverse_step + 1.0).max(0.0) as usize;
                let cell = cell.min(axis.len());
                // The points of a nearly uniform axis are off by less than a cell.
                if !above(cell) {
                    cell - 1
                } else if !below(cell) {
                    cell + 1
                } else {
                    cell
                }
            }
            None => axis.partition_point(|&point| point <= x),
        }
    }
}

/// The point that the polynomial of a cell is written about.
#[inline]
fn anchor(axis: &[f64], cell: usize) -> f64 {
    axis[cell.saturating_sub(1)]
}

/// Coefficients of the natural spline in every cell, the two linear ones
/// outside the grid included.
fn cells_1d(x: &[f64], values: &[f64]) -> Vec<[f64; 4]> {
    let n = x.len();
    let moments = natural_moments(x, values);
    let mut cells = Vec::with_capacity(n + 1);
    for i in 0..n - 1 {
        let h = x[i + 1] - x[i];
        let (m0, m1) = (moments[i], moments[i + 1]);
        let slope = (values[i + 1] - values[i]) / h - h * (2.0 * m0 + m1) / 6.0;
        if i == 0 {
            cells.push([values[0], slope, 0.0, 0.0]);
        }
        cells.push([values[i], slope, m0 / 2.0, (m1 - m0) / (6.0 * h)]);
    }
    let h = x[n - 1] - x[n - 2];
    let slope = (values[n - 1] - values[n - 2]) / h + h * moments[n - 2] / 6.0;
    cells.push([values[n - 1], slope, 0.0, 0.0]);
    cells
}

/// Coefficients of the tensor product: the spline in `y` through every row
/// of values, then the spline in `x` through each of its coefficients.
fn cells_2d(x: &[f64], y: &[f64], values: &[f64]) -> Vec<[f64; 4]> {
    let rows: Vec<Vec<[f64; 4]>> = (values.chunks(y.len())).map(|row| cells_1d(y, row)).collect();
    let columns = y.len() + 1;
    let mut cells = vec![[0.0; 4]; 4 * (x.len() + 1) * columns];
    for j in 0..columns {
        for power_y in 0..4 {
            let along_x: Vec<f64> = rows.iter().map(|row| row[j][power_y]).collect();
            for (i, in_x) in cells_1d(x, &along_x).into_iter().enumerate() {
                for (power_x, &c) in in_x.iter().enumerate() {
                    cells[4 * (i * columns + j) + power_x][power_y] = c;
                }
            }
        }
    }
    cells
}

/// Second derivatives at the grid points of the natural cubic spline, zero at
/// the ends. The system is diagonally dominant: no pivoting.
fn natural_moments(x: &[f64], values: &[f64]) -> Vec<f64> {
    let n = x.len();
    let mut moments = vec![0.0; n];
    let mut ratio = vec![0.0; n];
    for i in 1..n - 1 {
        let (before, after) = (x[i] - x[i - 1], x[i + 1] - x[i]);
        let bend = (values[i + 1] - values[i]) / after - (values[i] - values[i - 1]) / before;
        let pivot = 2.0 * (before + after) - before * ratio[i - 1];
        ratio[i] = after / pivot;
        moments[i] = (6.0 * bend - before * moments[i - 1]) / pivot;
    }
    for i in (1..n - 1).rev() {
        moments[i] -= ratio[i] * moments[i + 1];
    }
    moments
}

fn check(name: &str, axes: &[Vec<f64>], values: &[f64]) -> Result<(), TableError> {
    let table = || name.to_string();
    if axes.is_empty() || axes.len() > 2 {
        return Err(TableError::WrongDimension { table: table(), found: axes.len() });
    }
    for (axis, points) in ["x", "y"].into_iter().zip(axes) {
        if points.len() < 2 {
            return Err(TableError::TooFewPoints { table: table(), axis, count: points.len() });
        }
        check_finite(name, axis, points)?;
        let out_of_order = points.windows(2).position(|pair| pair[0] >= pair[1]);
        if let Some(i) = out_of_order {
            return Err(TableError::NotIncreasing {
                table: table(),
                axis,
                index: i + 1,
                before: points[i],
                value: points[i + 1],
            });
        }
    }
    let expected = axes.iter().map(Vec::len).product();
    if values.len() != expected {
        return Err(TableError::WrongLength { table: table(), expected, found: values.len() });
    }
    check_finite(name, "values", values)
}

fn check_finite(name: &str, what: &'static str, entries: &[f64]) -> Result<(), TableError> {
    match entries.iter().position(|entry| !entry.is_finite()) {
        Some(index) => {
            Err(TableError::NonFinite { table: name.to_string(), what, index, value: entries[index] })
        }
        None => Ok(()),
    }
}

fn bits(entries: &[f64]) -> impl Iterator<Item = u64> {
    entries.iter().map(|entry| entry.to_bits())
}

impl PartialEq for Table {
    fn eq(&self, other: &Table) -> bool {
        self.name == other.name
            && self.axes.len() == other.axes.len()
            && (self.axes.iter().zip(&other.axes)).all(|(a, b)| bits(a).eq(bits(b)))
            && bits(&self.values).eq(bits(&other.values))
    }
}

impl Eq for Table {}

impl Hash for Table {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.name.hash(state);
        for axis in &self.axes {
            axis.len().hash(state);
            bits(axis).for_each(|bits| bits.hash(state));
        }
        bits(&self.values).for_each(|bits| bits.hash(state));
    }
}

impl fmt::Debug for Table {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        // The coefficients follow from the rest and would bury it.
        f.debug_struct("Table")
            .field("name", &self.name)
            .field("axes", &self.axes)
            .field("values", &self.values)
            .finish_non_exhaustive()
    }
}
