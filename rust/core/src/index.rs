//! The numberings of an estimation problem, each with a type of its own: the compiler rejects the number of a parameter where
//! that of a variable is meant.
//!
//! | | numbers | counted |
//! |---|---|---|
//! | [`ParameterId`] | θ as the functions of a point see it | parameters of the model, then of the noise |
//! | [`VariableId`] | ξ, the unknowns of the program | parameters, some once an experiment, then the states of all points |
//! | [`ConstraintId`] | c(ξ) | defects of all experiments, then conditions on their ends |
//! | [`StateId`] | x | as the model declares them |
//! | [`PointId`] | points whose states are variables | over all experiments |
//! | [`ExperimentId`] | records | as they are given |
//!
//! A vector over ξ is a slice, which a `VariableId` alone of these may index. What else there is for each of something is an
//! [`IndexVec`]. Loops within one numbering may count by `usize`.

use std::marker::PhantomData;
use std::ops::{Add, Index, IndexMut};

macro_rules! numberings {
    ($($(#[$doc:meta])* $name:ident;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub usize);

        impl Numbering for $name {
            fn from_number(number: usize) -> Self {
                $name(number)
            }

            fn number(self) -> usize {
                self.0
            }
        }

        impl Add<usize> for $name {
            type Output = Self;

            #[inline(always)]
            fn add(self, more: usize) -> Self {
                $name(self.0 + more)
            }
        }
    )*};
}

/// A type of numbers from 0.
pub trait Numbering: Copy {
    /// Makes one.
    fn from_number(number: usize) -> Self;
    /// Returns it as a plain number.
    fn number(self) -> usize;
}

numberings! {
    /// A parameter of the model or of the noise, as the functions of a point see it.
    ParameterId;
    /// A variable of the nonlinear program.
    VariableId;
    /// A constraint of the nonlinear program.
    ConstraintId;
    /// A state of the model.
    StateId;
    /// A point of all experiments whose states are variables.
    PointId;
    /// An experiment.
    ExperimentId;
}

impl Index<VariableId> for [f64] {
    type Output = f64;

    #[inline(always)]
    fn index(&self, i: VariableId) -> &f64 {
        &self[i.0]
    }
}

impl IndexMut<VariableId> for [f64] {
    #[inline(always)]
    fn index_mut(&mut self, i: VariableId) -> &mut f64 {
        &mut self[i.0]
    }
}

impl Index<VariableId> for Vec<f64> {
    type Output = f64;

    #[inline(always)]
    fn index(&self, i: VariableId) -> &f64 {
        &self[i.0]
    }
}

impl IndexMut<VariableId> for Vec<f64> {
    #[inline(always)]
    fn index_mut(&mut self, i: VariableId) -> &mut f64 {
        &mut self[i.0]
    }
}

/// One object for each number of a numbering.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IndexVec<I, T> {
    items: Vec<T>,
    numbering: PhantomData<I>,
}

impl<I: Numbering, T> IndexVec<I, T> {
    /// Returns how many there are.
    pub fn len(&self) -> usize {
        self.items.len()
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// Adds one, and returns its number.
    pub fn push(&mut self, item: T) -> I {
        self.items.push(item);
        I::from_number(self.items.len() - 1)
    }

    /// Returns one, where there is such a number.
    pub fn get(&self, i: I) -> Option<&T> {
        self.items.get(i.number())
    }

    /// Iterates over all.
    pub fn iter(&self) -> std::slice::Iter<'_, T> {
        self.items.iter()
    }

    /// Iterates over all with their numbers.
    pub fn numbered(&self) -> impl Iterator<Item = (I, &T)> + Clone {
        self.items.iter().enumerate().map(|(i, item)| (I::from_number(i), item))
    }

    /// Returns all in their order.
    pub fn as_slice(&self) -> &[T] {
        &self.items
    }
}

impl<I, T> Default for IndexVec<I, T> {
    fn default() -> Self {
        IndexVec { items: Vec::new(), numbering: PhantomData }
    }
}

impl<I, T> FromIterator<T> for IndexVec<I, T> {
    fn from_iter<A: IntoIterator<Item = T>>(items: A) -> Self {
        IndexVec { items: items.into_iter().collect(), numbering: PhantomData }
    }
}

impl<'a, I: Numbering, T> IntoIterator for &'a IndexVec<I, T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.items.iter()
    }
}

impl<I: Numbering, T> Index<I> for IndexVec<I, T> {
    type Output = T;

    #[inline(always)]
    fn index(&self, i: I) -> &T {
        &self.items[i.number()]
    }
}

impl<I: Numbering, T> IndexMut<I> for IndexVec<I, T> {
    #[inline(always)]
    fn index_mut(&mut self, i: I) -> &mut T {
        &mut self.items[i.number()]
    }
}
