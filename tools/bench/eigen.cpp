/* The peer: the same update with Eigen at fixed sizes, in the forms one would
 * naturally write. bench.py takes the fastest of them. */
#include "bench.h"

#include <Eigen/Dense>

namespace {

constexpr int N = BENCH_LIFTED, M = BENCH_INPUTS, D = BENCH_REGRESSORS;

template <class T> struct Data;
template <> struct Data<float> {
	static const bench_sample_f32 &at(size_t k) { return bench_data_f32[k % BENCH_SAMPLES]; }
};
template <> struct Data<double> {
	static const bench_sample_f64 &at(size_t k) { return bench_data_f64[k % BENCH_SAMPLES]; }
};

template <class T> struct Rls {
	using Lifted = Eigen::Matrix<T, N, 1>;
	using Inputs = Eigen::Matrix<T, M, 1>;
	using Regressor = Eigen::Matrix<T, D, 1>;

	Eigen::Matrix<T, N, D> theta;
	Eigen::Matrix<T, D, D> P;
	Regressor z, g;
	Lifted e;

	void reset() {
		theta.setZero();
		P = Regressor::Constant(T(BENCH_P0)).asDiagonal();
	}

	template <class Sample> void load(const Sample &s) {
		z << Eigen::Map<const Lifted>(s.psi), Eigen::Map<const Inputs>(s.u);
		e = Eigen::Map<const Lifted>(s.psi_next);
		e.noalias() -= theta * z;
	}

	/* P = (P - K (z' P)) / lambda: the textbook's */
	template <class Sample> void textbook(const Sample &s) {
		load(s);
		g.noalias() = P * z;
		const Eigen::Matrix<T, 1, D> zP = z.transpose() * P;
		const Regressor K = g / (T(BENCH_LAMBDA) + z.dot(g));
		theta.noalias() += e * K.transpose();
		P.noalias() -= K * zP;
		P *= T(1) / T(BENCH_LAMBDA);
	}

	/* P = (P - g g' / s) / lambda, which spares z' P */
	template <class Sample> void outer(const Sample &s) {
		load(s);
		g.noalias() = P * z;
		const Regressor K = g / (T(BENCH_LAMBDA) + z.dot(g));
		theta.noalias() += e * K.transpose();
		P.noalias() -= K * g.transpose();
		P *= T(1) / T(BENCH_LAMBDA);
	}

	/* the same in one pass over P */
	template <class Sample> void fused(const Sample &s) {
		load(s);
		g.noalias() = P * z;
		const Regressor K = g / (T(BENCH_LAMBDA) + z.dot(g));
		theta += e.lazyProduct(K.transpose());
		P = (P - K.lazyProduct(g.transpose())) * (T(1) / T(BENCH_LAMBDA));
	}

	/* only the lower triangle of P is kept */
	template <class Sample> void triangle(const Sample &s) {
		load(s);
		g.noalias() = P.template selfadjointView<Eigen::Lower>() * z;
		const T inverse = T(1) / (T(BENCH_LAMBDA) + z.dot(g));
		theta.noalias() += e * (g * inverse).transpose();
		P.template selfadjointView<Eigen::Lower>().rankUpdate(g, -inverse);
		P.template triangularView<Eigen::Lower>() *= T(1) / T(BENCH_LAMBDA);
	}
};

template <class T> using Form = void (Rls<T>::*)(const decltype(Data<T>::at(0)) &);

template <class T> Rls<T> rls;

template <class T> void reset() {
	rls<T>.reset();
}

template <class T> void theta(double *out) {
	using RowMajor = Eigen::Matrix<double, N, D, Eigen::RowMajor>;
	Eigen::Map<RowMajor> map(out);
	map = rls<T>.theta.template cast<double>();
}

#define RUN(form)                                                                                            \
	template <class T> void run_##form(size_t count) {                                                       \
		for (size_t k = 0; k < count; k++) { rls<T>.form(Data<T>::at(k)); }                                  \
	}
RUN(textbook)
RUN(outer)
RUN(fused)
RUN(triangle)

} // namespace

#define CASES(precision, T)                                                                                  \
	{"rls_update", precision, "Eigen textbook", reset<T>, run_textbook<T>, theta<T>},                        \
	    {"rls_update", precision, "Eigen outer", reset<T>, run_outer<T>, theta<T>},                          \
	    {"rls_update", precision, "Eigen fused", reset<T>, run_fused<T>, theta<T>}, {                        \
		"rls_update", precision, "Eigen triangle", reset<T>, run_triangle<T>, theta<T>                       \
	}

extern "C" {
extern const bench_case bench_eigen[];
extern const size_t bench_eigen_count;
extern const char bench_eigen_version[];
}
#define TEXT_OF(x) #x
#define TEXT(x) TEXT_OF(x)
const char bench_eigen_version[] =
    TEXT(EIGEN_WORLD_VERSION) "." TEXT(EIGEN_MAJOR_VERSION) "." TEXT(EIGEN_MINOR_VERSION);
const bench_case bench_eigen[] = {CASES("f32", float), CASES("f64", double)};
const size_t bench_eigen_count = sizeof bench_eigen / sizeof *bench_eigen;
