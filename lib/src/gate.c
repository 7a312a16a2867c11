/* Outlier gate before the learner, as before a Kalman filter (Bar-Shalom, Li and Kirubarajan, "Estimation
 * with Applications to Tracking and Navigation", 2001, section 5.4). Innovations are normalised by their
 * variance. Individually they validate a sample; their mean square, the normalised innovation squared (NIS),
 * tests whether a model is consistent. The variance is learned here. */

#include <stddef.h>
#include <string.h>

#define GATE_MULTIPLE 5
#define GATE_PATIENCE 5
#define GATE_HOLD 1000
#define GATE_MEMORY 5000            /* samples in the variance */
#define GATE_WINDOW 4               /* window of a comparison, in samples per regressor */
#define GATE_CONSISTENT ((real)1.5) /* a model with a smaller mean NIS is consistent */
#define GATE_BETTER                                                                                          \
	((real)1.05) /* NIS of the learner over that of the saved model: the saved one is restored */
#define GATE_BETTER_AGAIN ((real)1.2) /* the same, if it has been restored before */
#define GATE_DOUBTFUL_NIS 5           /* a model with a larger mean NIS is doubtful */
#define GATE_REFUSED_NIS 12           /* a model with a larger mean NIS is refused */
#define GATE_MAX_COUNT ((size_t)-1 / 2)

/* The checksum covers these fields of the gate too: from `warm_up` to before `sum`. */
#define GATE_STATE offsetof(KOOP(gate), warm_up)
#define GATE_STATE_WORDS ((offsetof(KOOP(gate), sum) - GATE_STATE) / 4)

static COLD int gate_config_check(const KOOP(gate_config) *c) {
	if (!c) { return KOOP_OK; }
	/* Written so that NaN fails. */
	if (!(c->multiple >= 0 && is_finite(c->multiple * c->multiple))) { return KOOP_E_RANGE; }
	if (c->multiple > 0 && c->multiple < 1) { return KOOP_E_RANGE; }
	if (!(c->floor >= 0 && is_finite(c->floor * c->floor))) { return KOOP_E_RANGE; }
	return c->patience <= GATE_MAX_COUNT && c->hold <= GATE_MAX_COUNT ? KOOP_OK : KOOP_E_RANGE;
}

/* `config` may point to the gate's own configuration. */
static COLD void gate_configure(KOOP(gate) *gate, const KOOP(gate_config) *config) {
	const KOOP(gate_config) defaults = {0, 0, 0, 0};
	gate->config = config ? *config : defaults;
	if (!(gate->config.multiple > 0)) { gate->config.multiple = GATE_MULTIPLE; }
	if (gate->config.patience == 0) { gate->config.patience = GATE_PATIENCE; }
	if (gate->config.hold == 0) { gate->config.hold = GATE_HOLD; }
}

static size_t gate_window(const KOOP(gate) *gate) {
	return GATE_WINDOW * gate->saved.n_regressors;
}

/* Returns to the initial state, in which the variance is unknown. */
static COLD void gate_restart(KOOP(gate) *gate) {
	for (size_t i = 0; i < 3 * gate->saved.n_lifted; i++) { gate->variance[i] = 0; }
	(void)memset((unsigned char *)gate + GATE_STATE, 0, GATE_STATE_WORDS * 4);
	gate->warm_up = gate_window(gate);
	gate->trust = gate->worst = KOOP_DOUBTFUL;
}

/* ---- Flipped bits ----------------------------------------------------------------- */

static koop_checksum gate_sum(const KOOP(gate) *gate) {
	koop_checksum sum = {0, 0};
	checksum_add(&sum, gate->variance, WORDS(3 * gate->saved.n_lifted));
	checksum_add(&sum, (const unsigned char *)gate + GATE_STATE, GATE_STATE_WORDS);
	return sum;
}

static OUT_OF_LINE void gate_seal(KOOP(gate) *gate) {
	if (gate->saved.config.checksum) { gate->sum = gate_sum(gate); }
}

static COLD int gate_repair(KOOP(gate) *gate, const koop_checksum *now) {
	const size_t words = WORDS(3 * gate->saved.n_lifted);
	return checksum_has_flipped(&gate->sum, now) ||
	       checksum_repair(gate->variance, words, GATE_STATE_WORDS, &gate->sum, now) ||
	       checksum_repair((unsigned char *)gate + GATE_STATE, GATE_STATE_WORDS, 0, &gate->sum, now);
}

/* Restarts the gate if its state cannot be repaired. */
static void gate_verify(KOOP(gate) *gate) {
	if (!gate->saved.config.checksum) { return; }
	const koop_checksum now = gate_sum(gate);
	if (!checksum_same(&now, &gate->sum) && !gate_repair(gate, &now)) { gate_restart(gate); }
}

COLD int KOOP(gate_init)(KOOP(gate) *gate, const KOOP(gate_config) *config, const KOOP(rls) *rls,
                         real *storage, size_t reals) {
	size_t needed;
	if (!gate || !rls || !rls->theta || !storage) { return KOOP_E_NULL; }
	int status = gate_config_check(config);
	if (status == KOOP_OK) { status = KOOP(rls_reals)(&rls->config, &needed); }
	if (status != KOOP_OK) { return status; }
	const size_t N = rls->n_lifted;
	if (reals < needed + 3 * N) { return KOOP_E_STORAGE; }

	gate_configure(gate, config);
	(void)KOOP(rls_init)(&gate->saved, &rls->config, storage, needed);
	copy_learned(&gate->saved, rls);
	gate->variance = storage + needed;
	gate->recent_variance = gate->variance + N;
	gate->previous_variance = gate->recent_variance + N;
	gate_restart(gate);
	gate_seal(gate);
	return KOOP_OK;
}

/* ---- Individual innovations: outliers ------------------------------------------ */

static real gate_with_floor(const KOOP(gate) *gate, real variance) {
	return max_of(variance, gate->config.floor * gate->config.floor);
}

static real gate_variance(const KOOP(gate) *gate, size_t i) {
	return gate_with_floor(gate, gate->variance[i]);
}

/* The largest square of an innovation that is not an outlier. */
static real gate_max_square(const KOOP(gate) *gate, size_t i) {
	return gate->config.multiple * gate->config.multiple *
	       max_of(gate_variance(gate, i), gate->recent_variance[i]);
}

/* Returns 1 if no innovation is an outlier. Before the variance is known, none is. */
static int gate_admits(const KOOP(gate) *gate, const real *error) {
	if (gate->grace > 0 || gate->n_variance < gate_window(gate)) { return 1; }
	for (size_t i = 0; i < gate->saved.n_lifted; i++) {
		if (!(error[i] * error[i] <= gate_max_square(gate, i))) { return 0; }
	}
	return 1;
}

/* Adds a sample to the variance: an arithmetic mean at first, then an exponential mean of GATE_MEMORY
 * samples. */
static void gate_update_variance(KOOP(gate) *gate, const real *error) {
	gate->n_variance += gate->n_variance < GATE_MEMORY;
	for (size_t i = 0; i < gate->saved.n_lifted; i++) {
		gate->variance[i] += (error[i] * error[i] - gate->variance[i]) / (real)gate->n_variance;
	}
}

/* Adds a sample to the recent variance, clipped to the largest admitted square. The term with REAL_EPSILON
 * lets the recent variance grow from 0. */
static void gate_update_recent(KOOP(gate) *gate, const real *error) {
	const size_t window = gate_window(gate);
	for (size_t i = 0; i < gate->saved.n_lifted; i++) {
		const real square = error[i] * error[i], limit = gate_max_square(gate, i);
		const real seen = square < limit ? square : max_of(limit, REAL_EPSILON * square);
		gate->recent_variance[i] += (seen - gate->recent_variance[i]) / (real)window;
	}
}

static void gate_count_accepted(KOOP(gate) *gate, const real *error) {
	gate_update_recent(gate, error);
	if (gate->grace > 0) {
		gate->grace--;
	} else if (gate->warm_up > 0) {
		gate->warm_up--;
	} else {
		if (gate->suspect_for == 0) { gate_update_variance(gate, error); }
		gate->refused -= gate->refused > 0;
	}
}

OUT_OF_LINE static void gate_count(KOOP(gate) *gate, const real *error, int status) {
	if (status == KOOP_OK) { gate_count_accepted(gate, error); }
	if (status == KOOP_E_OUTLIER && ++gate->refused >= gate->config.patience) {
		gate->grace = gate_window(gate);
	}
}

/* ---- Mean square: the learner compared with the saved learner --------------------- */

/* Mean over the elements of the innovation squared over `variance`, at most the largest admitted value. */
static real gate_nis(const KOOP(gate) *gate, const real *error, const real *variance) {
	real sum = 0;
	for (size_t i = 0; i < gate->saved.n_lifted; i++) {
		sum += error[i] * error[i] / (gate_with_floor(gate, variance[i]) + REAL_MIN);
	}
	const real mean = sum / (real)gate->saved.n_lifted, limit = gate->config.multiple * gate->config.multiple;
	return mean < limit ? mean : limit; /* NaN and Inf too */
}

/* Returns 1 if a model with this sum of NIS over the window is consistent. */
static int gate_is_consistent(const KOOP(gate) *gate, real nis) {
	return nis < GATE_CONSISTENT * (real)gate->judged;
}

/* Learns the variance again, after a change. The previous variance is kept: the change may be a fault that
 * ends. */
static COLD void gate_restart_variance(KOOP(gate) *gate) {
	if (!gate->changed) { copy(gate->previous_variance, gate->variance, gate->saved.n_lifted); }
	gate->changed = 1;
	gate->n_variance = gate_window(gate);
}

/* Restores the variance from before the change, if the learner is consistent with it over a window. */
static COLD void gate_recall_variance(KOOP(gate) *gate) {
	if (gate->changed && gate_is_consistent(gate, gate->previous_nis)) {
		copy(gate->variance, gate->previous_variance, gate->saved.n_lifted);
		copy(gate->recent_variance, gate->previous_variance, gate->saved.n_lifted);
		gate->changed = 0;
	}
}

/* Returns 1 if the saved learner may be replaced by the present one. That is so if the saved learner still
 * predicts consistently, so that no fault acts, or if it has not for so long that the robot must have
 * changed. */
static COLD int gate_may_save(KOOP(gate) *gate) {
	if (gate->n_variance <= gate_window(gate) || gate_is_consistent(gate, gate->saved_nis)) {
		gate->suspect_for = 0;
		return 1;
	}
	gate->suspect_for += gate->judged;
	if (gate->suspect_for < gate->config.hold) { return 0; }
	gate->suspect_for = 0;
	gate_restart_variance(gate);
	return 1;
}

/* Restores the saved learner. P is restored only the first time, since P may be the cause. P is reset if no
 * sample of the window could be learned. */
static COLD void gate_restore(KOOP(gate) *gate, KOOP(rls) *rls, int lost) {
	if (gate->restored_once) {
		(void)KOOP(rls_copy_theta)(rls, gate->saved.theta);
	} else {
		copy_learned(rls, &gate->saved);
	}
	if (lost) { (void)KOOP(rls_reset_covariance)(rls, rls->config.p0); }
	gate->restored_once = 1;
	gate->restored++;
}

/* Returns 1 if the saved learner predicts better, and either the learner is inconsistent or a fault may act.
 */
static COLD int gate_saved_is_better(const KOOP(gate) *gate) {
	const int suspect = gate->suspect_for > 0 || !gate_is_consistent(gate, gate->nis);
	return suspect && (gate->restored_once ? GATE_BETTER_AGAIN : GATE_BETTER) * gate->saved_nis < gate->nis;
}

/* ---- Trust ------------------------------------------------------------------------- */

/* Trust after one sample. */
static int gate_event(const KOOP(gate) *gate, const KOOP(rls) *rls, int status) {
	const size_t window = gate_window(gate);
	if (status != KOOP_OK && status != KOOP_E_OUTLIER) { return KOOP_REFUSE; }
	if (!rls->positive_definite || gate->nis > GATE_REFUSED_NIS * (real)window) { return KOOP_REFUSE; }
	return status == KOOP_OK && gate->grace == 0 && gate->n_variance > window ? KOOP_TRUSTED : KOOP_DOUBTFUL;
}

/* Trust falls immediately. */
static void gate_lower_trust(KOOP(gate) *gate, const KOOP(rls) *rls, int status) {
	const int event = gate_event(gate, rls, status);
	gate->worst = event > gate->worst ? event : gate->worst;
	gate->trust = gate->worst > gate->trust ? gate->worst : gate->trust;
}

/* Trust rises by one level at the end of a window without an alarm. */
static COLD void gate_end_window(KOOP(gate) *gate) {
	const int doubtful = gate->nis > GATE_DOUBTFUL_NIS * (real)gate->judged;
	if (doubtful && gate->worst == KOOP_TRUSTED) { gate->worst = KOOP_DOUBTFUL; }
	gate->trust = gate->worst < gate->trust ? gate->trust - 1 : gate->worst;
	gate->worst = KOOP_TRUSTED;
}

/* Restores or saves the learner at the end of a window. */
static COLD void gate_decide(KOOP(gate) *gate, KOOP(rls) *rls) {
	gate_recall_variance(gate);
	const int lost = gate->failed == gate->judged, saved_is_better = gate_saved_is_better(gate),
	          may_save = gate_may_save(gate);
	if (lost || saved_is_better) {
		gate_restore(gate, rls, lost);
	} else if (may_save) {
		copy_learned(&gate->saved, rls);
		gate->restored_once = 0;
	}
	gate_end_window(gate);
	gate->judged = gate->failed = 0;
	gate->nis = gate->saved_nis = gate->previous_nis = 0;
}

OUT_OF_LINE static void gate_compare(KOOP(gate) *gate, KOOP(rls) *rls, int status, const real *psi_next) {
	real *error = gate->saved.error;
	weighted_rows(error, gate->saved.theta, rls->zeta, rls->n_regressors, rls->n_lifted_padded);
	(void)subtract_from(error, psi_next, rls->n_lifted);
	gate->nis += gate_nis(gate, rls->error, gate->variance);
	gate->saved_nis += gate_nis(gate, error, gate->variance);
	if (gate->changed) { gate->previous_nis += gate_nis(gate, rls->error, gate->previous_variance); }
	gate->failed += status != KOOP_OK && status != KOOP_E_OUTLIER;
	gate_lower_trust(gate, rls, status);
	if (++gate->judged == gate_window(gate)) { gate_decide(gate, rls); }
}

static OUT_OF_LINE void gate_observe(KOOP(gate) *gate, KOOP(rls) *rls, int status, const real *psi_next) {
	if (status == KOOP_E_MEMORY) { /* the sample was not tested */
		gate_lower_trust(gate, rls, status);
		return;
	}
	gate_count(gate, rls->error, status);
	gate_compare(gate, rls, status, psi_next);
}

/* Replaces a learner that cannot be repaired by the saved one, if that is intact. */
static COLD int gate_replace(KOOP(gate) *gate, KOOP(rls) *rls) {
	const int status = verify(&gate->saved);
	if (status == KOOP_OK) {
		copy_learned(rls, &gate->saved);
		gate->restored++;
	}
	return status;
}

/* Verifies and repairs the gate and the learner, or returns a status. */
static OUT_OF_LINE int gate_secure(KOOP(gate) *gate, KOOP(rls) *rls) {
	gate_verify(gate);
	if (verify(rls) != KOOP_OK) { return gate_replace(gate, rls); }
	if (verify(&gate->saved) != KOOP_OK) { copy_learned(&gate->saved, rls); }
	return KOOP_OK;
}

/* ---- Public ------------------------------------------------------------------- */

static int gate_check(const KOOP(gate) *g, const KOOP(rls) *rls) {
	if (!g || !g->variance || !rls || !rls->theta) { return KOOP_E_NULL; }
	return same_kind(&g->saved, rls) ? KOOP_OK : KOOP_E_SIZE;
}

int KOOP(gate_update)(KOOP(gate) *gate, KOOP(rls) *rls, const real *psi, const real *u, const real *psi_next,
                      KOOP(health) *health) {
	real innovation = 0;
	int frozen = 0;
	int status = gate_check(gate, rls);
	if (status != KOOP_OK) { return status; }
	if (!psi || !u || !psi_next) { return KOOP_E_NULL; }

	status = gate_secure(gate, rls);
	if (status == KOOP_OK) { status = innovate(rls, psi, u, psi_next, &innovation); }
	if (status == KOOP_OK && !gate_admits(gate, rls->error)) { status = KOOP_E_OUTLIER; }
	if (status == KOOP_OK) { status = learn(rls, innovation, &frozen); }
	report(rls, status, innovation, frozen, health);
	/* a sample that is not finite does not test the model */
	if (status != KOOP_E_INPUT) { gate_observe(gate, rls, status, psi_next); }
	gate_seal(gate);
	return status;
}

int KOOP(gate_trust)(const KOOP(gate) *gate) {
	return gate && gate->variance ? gate->trust : KOOP_E_NULL;
}
