/* A gate before the learner, as before a Kalman filter: innovations over what they usually are, one by
 * one to validate a sample, in the mean to see whether a model is still consistent (Bar-Shalom, Li and
 * Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4). What is usual
 * is learned here. */

#include <stddef.h>
#include <string.h>

#define GATE_MULTIPLE 5
#define GATE_PATIENCE 5
#define GATE_HOLD 1000
#define GATE_MEMORY 5000              /* samples in the mean squares */
#define GATE_WINDOW 4                 /* regressors times this: samples that a model is judged by */
#define GATE_CONSISTENT ((real)1.5)   /* times the usual mean square: below it, a model is consistent */
#define GATE_BETTER ((real)1.05)      /* times smaller than the learner's: little by little would add up */
#define GATE_BETTER_AGAIN ((real)1.2) /* likewise, where it has come back already */
#define GATE_DOUBT 5                  /* times the usual mean square over a window: the model is doubtful */
#define GATE_ALARM 12                 /* likewise: it is refused */
#define GATE_MOST ((size_t)-1 / 2)

/* What changes from sample to sample beside the mean squares: from `warm_up` to before `sum`. */
#define GATE_STATE offsetof(KOOP(gate), warm_up)
#define GATE_STATE_WORDS ((offsetof(KOOP(gate), sum) - GATE_STATE) / 4)

static COLD int gate_config_check(const KOOP(gate_config) *c) {
	if (!c) { return KOOP_OK; }
	/* written so that NaN fails */
	if (!(c->multiple >= 0 && is_finite(c->multiple * c->multiple))) { return KOOP_E_RANGE; }
	if (c->multiple > 0 && c->multiple < 1) { return KOOP_E_RANGE; }
	if (!(c->floor >= 0 && is_finite(c->floor * c->floor))) { return KOOP_E_RANGE; }
	return c->patience <= GATE_MOST && c->hold <= GATE_MOST ? KOOP_OK : KOOP_E_RANGE;
}

/* `config` may be the gate's own. */
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

/* As at the start, when it is not known what is usual. */
static COLD void gate_begin(KOOP(gate) *gate) {
	for (size_t i = 0; i < 3 * gate->saved.n_lifted; i++) { gate->variance[i] = 0; }
	(void)memset((unsigned char *)gate + GATE_STATE, 0, GATE_STATE_WORDS * 4);
	gate->warm_up = gate_window(gate);
	gate->trust = gate->worst = KOOP_DOUBTFUL;
}

/* ---- In a memory whose bits may flip ---------------------------------------------- */

static koop_checksum gate_sum(const KOOP(gate) *gate) {
	koop_checksum sum = {0, 0};
	checksum_add(&sum, gate->variance, WORDS(3 * gate->saved.n_lifted));
	checksum_add(&sum, (const unsigned char *)gate + GATE_STATE, GATE_STATE_WORDS);
	return sum;
}

static OUT_OF_LINE void gate_seal(KOOP(gate) *gate) {
	if (gate->saved.config.checksum) { gate->sum = gate_sum(gate); }
}

static COLD int gate_mend(KOOP(gate) *gate, const koop_checksum *now) {
	const size_t words = WORDS(3 * gate->saved.n_lifted);
	return checksum_has_flipped(&gate->sum, now) ||
	       checksum_mend(gate->variance, words, GATE_STATE_WORDS, &gate->sum, now) ||
	       checksum_mend((unsigned char *)gate + GATE_STATE, GATE_STATE_WORDS, 0, &gate->sum, now);
}

/* What cannot be mended begins again. */
static void gate_verify(KOOP(gate) *gate) {
	if (!gate->saved.config.checksum) { return; }
	const koop_checksum now = gate_sum(gate);
	if (!checksum_same(&now, &gate->sum) && !gate_mend(gate, &now)) { gate_begin(gate); }
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
	take_over(&gate->saved, rls);
	gate->variance = storage + needed;
	gate->recent_variance = gate->variance + N;
	gate->previous_variance = gate->recent_variance + N;
	gate_begin(gate);
	gate_seal(gate);
	return KOOP_OK;
}

/* ---- One by one: outliers ------------------------------------------------------ */

static real gate_at_least_floor(const KOOP(gate) *gate, real usual) {
	return max_of(usual, gate->config.floor * gate->config.floor);
}

static real gate_usual(const KOOP(gate) *gate, size_t i) {
	return gate_at_least_floor(gate, gate->variance[i]);
}

/* The largest square that is no outlier. */
static real gate_most(const KOOP(gate) *gate, size_t i) {
	return gate->config.multiple * gate->config.multiple *
	       max_of(gate_usual(gate, i), gate->recent_variance[i]);
}

/* Whether no innovation is an outlier; before it is known what is usual, none is. */
static int gate_admits(const KOOP(gate) *gate, const real *error) {
	if (gate->grace > 0 || gate->n_variance < gate_window(gate)) { return 1; }
	for (size_t i = 0; i < gate->saved.n_lifted; i++) {
		if (!(error[i] * error[i] <= gate_most(gate, i))) { return 0; }
	}
	return 1;
}

/* The mean squares with one more sample: plain means at first, then those of GATE_MEMORY samples. */
static void gate_learn_usual(KOOP(gate) *gate, const real *error) {
	gate->n_variance += gate->n_variance < GATE_MEMORY;
	for (size_t i = 0; i < gate->saved.n_lifted; i++) {
		gate->variance[i] += (error[i] * error[i] - gate->variance[i]) / (real)gate->n_variance;
	}
}

/* Likewise over a window; of each sample no more than the gate admits. The last term grows from nothing. */
static void gate_learn_recent(KOOP(gate) *gate, const real *error) {
	const size_t window = gate_window(gate);
	for (size_t i = 0; i < gate->saved.n_lifted; i++) {
		const real square = error[i] * error[i], most = gate_most(gate, i);
		const real seen = square < most ? square : max_of(most, REAL_EPSILON * square);
		gate->recent_variance[i] += (seen - gate->recent_variance[i]) / (real)window;
	}
}

static void gate_count_taken(KOOP(gate) *gate, const real *error) {
	gate_learn_recent(gate, error);
	if (gate->grace > 0) {
		gate->grace--;
	} else if (gate->warm_up > 0) {
		gate->warm_up--;
	} else {
		if (gate->suspect_for == 0) { gate_learn_usual(gate, error); }
		gate->refused -= gate->refused > 0;
	}
}

OUT_OF_LINE static void gate_count(KOOP(gate) *gate, const real *error, int status) {
	if (status == KOOP_OK) { gate_count_taken(gate, error); }
	if (status == KOOP_E_OUTLIER && ++gate->refused >= gate->config.patience) {
		gate->grace = gate_window(gate);
	}
}

/* ---- In the mean: the learner against what is saved ------------------------------- */

/* The mean of the squares over those of `usual`, at most what the gate admits. */
static real gate_strain(const KOOP(gate) *gate, const real *error, const real *usual) {
	real sum = 0;
	for (size_t i = 0; i < gate->saved.n_lifted; i++) {
		sum += error[i] * error[i] / (gate_at_least_floor(gate, usual[i]) + REAL_MIN);
	}
	const real mean = sum / (real)gate->saved.n_lifted, most = gate->config.multiple * gate->config.multiple;
	return mean < most ? mean : most; /* NaN and Inf too */
}

/* Whether a model has predicted as usual over a window. */
static int gate_is_consistent(const KOOP(gate) *gate, real strain) {
	return strain < GATE_CONSISTENT * (real)gate->judged;
}

/* What is usual is learned again, as after a change. What it was stays known: the change may be a fault that
 * ends. */
static COLD void gate_begin_usual(KOOP(gate) *gate) {
	if (!gate->changed) { copy(gate->previous_variance, gate->variance, gate->saved.n_lifted); }
	gate->changed = 1;
	gate->n_variance = gate_window(gate);
}

/* What was usual before the change is so again, where the learner has predicted by that over a window. */
static COLD void gate_recall_usual(KOOP(gate) *gate) {
	if (gate->changed && gate_is_consistent(gate, gate->previous_nis)) {
		copy(gate->variance, gate->previous_variance, gate->saved.n_lifted);
		copy(gate->recent_variance, gate->previous_variance, gate->saved.n_lifted);
		gate->changed = 0;
	}
}

/* Whether what is saved may be replaced by what the learner knows now: it predicts as usual, so no fault is
 * at work, or has not for so long that the robot must have changed. */
static COLD int gate_believes(KOOP(gate) *gate) {
	if (gate->n_variance <= gate_window(gate) || gate_is_consistent(gate, gate->saved_nis)) {
		gate->suspect_for = 0;
		return 1;
	}
	gate->suspect_for += gate->judged;
	if (gate->suspect_for < gate->config.hold) { return 0; }
	gate->suspect_for = 0;
	gate_begin_usual(gate);
	return 1;
}

/* What is saved comes back: all of it, but P only once, as it may be P that leads astray, and begun again
 * where nothing could be learned at all. */
static COLD void gate_restore(KOOP(gate) *gate, KOOP(rls) *rls, int lost) {
	if (gate->restored_once) {
		(void)KOOP(rls_copy_theta)(rls, gate->saved.theta);
	} else {
		take_over(rls, &gate->saved);
	}
	if (lost) { (void)KOOP(rls_reset_covariance)(rls, rls->config.p0); }
	gate->restored_once = 1;
	gate->restored++;
}

/* Whether what is saved has done better, and the learner worse than usual or through what may be a fault. */
static COLD int gate_regrets(const KOOP(gate) *gate) {
	const int suspect = gate->suspect_for > 0 || !gate_is_consistent(gate, gate->nis);
	return suspect && (gate->restored_once ? GATE_BETTER_AGAIN : GATE_BETTER) * gate->saved_nis < gate->nis;
}

/* ---- Whether the model is to be trusted -------------------------------------------- */

/* By a sample alone. */
static int gate_event(const KOOP(gate) *gate, const KOOP(rls) *rls, int status) {
	const size_t window = gate_window(gate);
	if (status != KOOP_OK && status != KOOP_E_OUTLIER) { return KOOP_REFUSE; }
	if (!rls->positive_definite || gate->nis > GATE_ALARM * (real)window) { return KOOP_REFUSE; }
	return status == KOOP_OK && gate->grace == 0 && gate->n_variance > window ? KOOP_TRUSTED : KOOP_DOUBTFUL;
}

/* At once for the worse. */
static void gate_watch(KOOP(gate) *gate, const KOOP(rls) *rls, int status) {
	const int event = gate_event(gate, rls, status);
	gate->worst = event > gate->worst ? event : gate->worst;
	gate->trust = gate->worst > gate->trust ? gate->worst : gate->trust;
}

/* For the better by one step at the end of a window in which nothing spoke against it. */
static COLD void gate_settle(KOOP(gate) *gate) {
	const int doubtful = gate->nis > GATE_DOUBT * (real)gate->judged;
	if (doubtful && gate->worst == KOOP_TRUSTED) { gate->worst = KOOP_DOUBTFUL; }
	gate->trust = gate->worst < gate->trust ? gate->trust - 1 : gate->worst;
	gate->worst = KOOP_TRUSTED;
}

/* At the end of a window. */
static COLD void gate_decide(KOOP(gate) *gate, KOOP(rls) *rls) {
	gate_recall_usual(gate);
	const int lost = gate->failed == gate->judged, regrets = gate_regrets(gate),
	          believes = gate_believes(gate);
	if (lost || regrets) {
		gate_restore(gate, rls, lost);
	} else if (believes) {
		take_over(&gate->saved, rls);
		gate->restored_once = 0;
	}
	gate_settle(gate);
	gate->judged = gate->failed = 0;
	gate->nis = gate->saved_nis = gate->previous_nis = 0;
}

OUT_OF_LINE static void gate_compare(KOOP(gate) *gate, KOOP(rls) *rls, int status, const real *psi_next) {
	real *error = gate->saved.error;
	weighted_rows(error, gate->saved.theta, rls->zeta, rls->n_regressors, rls->n_lifted_padded);
	(void)subtract_from(error, psi_next, rls->n_lifted);
	gate->nis += gate_strain(gate, rls->error, gate->variance);
	gate->saved_nis += gate_strain(gate, error, gate->variance);
	if (gate->changed) { gate->previous_nis += gate_strain(gate, rls->error, gate->previous_variance); }
	gate->failed += status != KOOP_OK && status != KOOP_E_OUTLIER;
	gate_watch(gate, rls, status);
	if (++gate->judged == gate_window(gate)) { gate_decide(gate, rls); }
}

static OUT_OF_LINE void gate_see(KOOP(gate) *gate, KOOP(rls) *rls, int status, const real *psi_next) {
	if (status == KOOP_E_MEMORY) { /* it says nothing of the sample */
		gate_watch(gate, rls, status);
		return;
	}
	gate_count(gate, rls->error, status);
	gate_compare(gate, rls, status, psi_next);
}

/* More bits of the learner have flipped than can be mended: what is saved, if that is as it was left. */
static COLD int gate_replace(KOOP(gate) *gate, KOOP(rls) *rls) {
	const int status = verify(&gate->saved);
	if (status == KOOP_OK) {
		take_over(rls, &gate->saved);
		gate->restored++;
	}
	return status;
}

/* The gate and the learner as they were left, or a status. */
static OUT_OF_LINE int gate_secure(KOOP(gate) *gate, KOOP(rls) *rls) {
	gate_verify(gate);
	if (verify(rls) != KOOP_OK) { return gate_replace(gate, rls); }
	if (verify(&gate->saved) != KOOP_OK) { take_over(&gate->saved, rls); }
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
	int gated = 0;
	int status = gate_check(gate, rls);
	if (status != KOOP_OK) { return status; }
	if (!psi || !u || !psi_next) { return KOOP_E_NULL; }

	status = gate_secure(gate, rls);
	if (status == KOOP_OK) { status = innovate(rls, psi, u, psi_next, &innovation); }
	if (status == KOOP_OK && !gate_admits(gate, rls->error)) { status = KOOP_E_OUTLIER; }
	if (status == KOOP_OK) { status = learn(rls, innovation, &gated); }
	report(rls, status, innovation, gated, health);
	/* a sensor that is not there says nothing of the model */
	if (status != KOOP_E_INPUT) { gate_see(gate, rls, status, psi_next); }
	gate_seal(gate);
	return status;
}

int KOOP(gate_trust)(const KOOP(gate) *gate) {
	return gate && gate->variance ? gate->trust : KOOP_E_NULL;
}
